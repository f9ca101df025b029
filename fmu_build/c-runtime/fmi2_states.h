/* Which FMI function may be called in which state of an instance: the table of FMI 2.0.4, section 4.2.4.
 *
 * There are no asynchronous steps, so that the states "step in progress" and "step canceled" do not exist. Beyond the
 * table, inputs may be set and a step may be tried after a failed one: the instance is at the last successful time then. */
#ifndef FLEXFMU_FMI2_STATES_H
#define FLEXFMU_FMI2_STATES_H

typedef enum {
  INSTANTIATED = 1 << 0,
  INITIALISATION_MODE = 1 << 1,
  STEP_COMPLETE = 1 << 2,
  STEP_FAILED = 1 << 3,
  TERMINATED = 1 << 4
} flex_phase;

#define ANY_PHASE (INSTANTIATED | INITIALISATION_MODE | STEP_COMPLETE | STEP_FAILED | TERMINATED)
#define SETTABLE_PHASE (INSTANTIATED | INITIALISATION_MODE | STEP_COMPLETE | STEP_FAILED)
#define READABLE_PHASE (INITIALISATION_MODE | STEP_COMPLETE | STEP_FAILED | TERMINATED)
#define STEPPED_PHASE (STEP_COMPLETE | STEP_FAILED | TERMINATED)

/* X(function, phases) */
#define FLEX_FMI2_CALLS(X)                              \
  X(fmi2SetDebugLogging, ANY_PHASE)                     \
  X(fmi2SetupExperiment, INSTANTIATED)                  \
  X(fmi2EnterInitializationMode, INSTANTIATED)          \
  X(fmi2ExitInitializationMode, INITIALISATION_MODE)    \
  X(fmi2Terminate, STEP_COMPLETE | STEP_FAILED)         \
  X(fmi2Reset, ANY_PHASE)                               \
  X(fmi2GetReal, ANY_PHASE)                             \
  X(fmi2GetInteger, ANY_PHASE)                          \
  X(fmi2GetBoolean, READABLE_PHASE)                     \
  X(fmi2GetString, READABLE_PHASE)                      \
  X(fmi2SetReal, SETTABLE_PHASE)                        \
  X(fmi2SetInteger, SETTABLE_PHASE)                     \
  X(fmi2SetBoolean, SETTABLE_PHASE)                     \
  X(fmi2SetString, SETTABLE_PHASE)                      \
  X(fmi2GetFMUstate, ANY_PHASE)                         \
  X(fmi2SetFMUstate, ANY_PHASE)                         \
  X(fmi2FreeFMUstate, ANY_PHASE)                        \
  X(fmi2SerializedFMUstateSize, ANY_PHASE)              \
  X(fmi2SerializeFMUstate, ANY_PHASE)                   \
  X(fmi2DeSerializeFMUstate, ANY_PHASE)                 \
  X(fmi2GetDirectionalDerivative, READABLE_PHASE)       \
  X(fmi2SetRealInputDerivatives, SETTABLE_PHASE)        \
  X(fmi2GetRealOutputDerivatives, READABLE_PHASE)       \
  X(fmi2DoStep, STEP_COMPLETE | STEP_FAILED)            \
  X(fmi2CancelStep, 0)                                  \
  X(fmi2GetStatus, STEPPED_PHASE)                       \
  X(fmi2GetRealStatus, STEPPED_PHASE)                   \
  X(fmi2GetIntegerStatus, STEPPED_PHASE)                \
  X(fmi2GetBooleanStatus, STEPPED_PHASE)                \
  X(fmi2GetStringStatus, STEPPED_PHASE)

/* call_fmi2DoStep and so on */
typedef enum {
#define X(function, phases) call_##function,
  FLEX_FMI2_CALLS(X)
#undef X
} flex_call_id;

#endif

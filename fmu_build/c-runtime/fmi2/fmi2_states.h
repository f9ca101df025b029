/* Which FMI function may be called in which state of an instance: the tables of FMI 2.0.4, sections 3.2.3 (model
 * exchange) and 4.2.4 (co-simulation).
 *
 * There are no asynchronous steps, so that the states "step in progress" and "step canceled" do not exist. Beyond the
 * table, inputs may be set and a step may be tried after a failed one: the instance is at the last successful time then. */
#ifndef FLEXFMU_FMI2_STATES_H
#define FLEXFMU_FMI2_STATES_H

#include "phases.h"

#define STEPPING_PHASE (STEP_COMPLETE | STEP_FAILED)
#define STEPPED_PHASE (STEPPING_PHASE | TERMINATED)

/* X(function, kinds, phases) */
#define FLEX_FMI2_CALLS(X)                                       \
  X(fmi2SetDebugLogging, BOTH, ANY_PHASE)                        \
  X(fmi2SetupExperiment, BOTH, INSTANTIATED)                     \
  X(fmi2EnterInitializationMode, BOTH, INSTANTIATED)             \
  X(fmi2ExitInitializationMode, BOTH, INITIALISATION_MODE)       \
  X(fmi2Terminate, BOTH, RUNNING_PHASE)                          \
  X(fmi2Reset, BOTH, ANY_PHASE)                                  \
  X(fmi2GetReal, BOTH, ANY_PHASE)                                \
  X(fmi2GetInteger, BOTH, ANY_PHASE)                             \
  X(fmi2GetBoolean, BOTH, READABLE_PHASE)                        \
  X(fmi2GetString, BOTH, READABLE_PHASE)                         \
  X(fmi2SetReal, BOTH, SETTABLE_PHASE | CONTINUOUS_TIME_MODE)    \
  X(fmi2SetInteger, BOTH, SETTABLE_PHASE)                        \
  X(fmi2SetBoolean, BOTH, SETTABLE_PHASE)                        \
  X(fmi2SetString, BOTH, SETTABLE_PHASE)                         \
  X(fmi2GetFMUstate, BOTH, ANY_PHASE)                            \
  X(fmi2SetFMUstate, BOTH, ANY_PHASE)                            \
  X(fmi2FreeFMUstate, BOTH, ANY_PHASE)                           \
  X(fmi2SerializedFMUstateSize, BOTH, ANY_PHASE)                 \
  X(fmi2SerializeFMUstate, BOTH, ANY_PHASE)                      \
  X(fmi2DeSerializeFMUstate, BOTH, ANY_PHASE)                    \
  X(fmi2GetDirectionalDerivative, BOTH, READABLE_PHASE)          \
  X(fmi2EnterEventMode, EXCHANGE, SOLVED_PHASE)                  \
  X(fmi2NewDiscreteStates, EXCHANGE, EVENT_MODE)                 \
  X(fmi2EnterContinuousTimeMode, EXCHANGE, EVENT_MODE)           \
  X(fmi2CompletedIntegratorStep, EXCHANGE, CONTINUOUS_TIME_MODE) \
  X(fmi2SetTime, EXCHANGE, SOLVED_PHASE)                         \
  X(fmi2SetContinuousStates, EXCHANGE, CONTINUOUS_TIME_MODE)     \
  X(fmi2GetDerivatives, EXCHANGE, READABLE_PHASE)                \
  X(fmi2GetEventIndicators, EXCHANGE, READABLE_PHASE)            \
  X(fmi2GetContinuousStates, EXCHANGE, READABLE_PHASE)           \
  X(fmi2GetNominalsOfContinuousStates, EXCHANGE, ANY_PHASE)      \
  X(fmi2SetRealInputDerivatives, STEPPING, SETTABLE_PHASE)       \
  X(fmi2GetRealOutputDerivatives, STEPPING, READABLE_PHASE)      \
  X(fmi2DoStep, STEPPING, STEPPING_PHASE)                        \
  X(fmi2CancelStep, STEPPING, 0)                                 \
  X(fmi2GetStatus, STEPPING, STEPPED_PHASE)                      \
  X(fmi2GetRealStatus, STEPPING, STEPPED_PHASE)                  \
  X(fmi2GetIntegerStatus, STEPPING, STEPPED_PHASE)               \
  X(fmi2GetBooleanStatus, STEPPING, STEPPED_PHASE)               \
  X(fmi2GetStringStatus, STEPPING, STEPPED_PHASE)

/* call_fmi2DoStep and so on */
typedef enum {
#define X(function, kinds, phases) call_##function,
  FLEX_FMI2_CALLS(X)
#undef X
} flex_call_id;

#endif

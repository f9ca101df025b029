/* States of an instance, sets of them, and which of the functions that both versions have may be called in which; fmi2_states.h and
 * fmi3_states.h add those of one version. */
#ifndef FLEXFMU_PHASES_H
#define FLEXFMU_PHASES_H

typedef enum {
  INSTANTIATED = 1 << 0,
  INITIALISATION_MODE = 1 << 1,
  STEP_COMPLETE = 1 << 2,
  STEP_MODE = STEP_COMPLETE, /* its name in FMI 3.0, where a step that fails leads to no state of its own */
  EVENT_MODE = 1 << 3,
  CONTINUOUS_TIME_MODE = 1 << 4,
  TERMINATED = 1 << 5,
  STEP_FAILED = 1 << 6,
  /* FMI 3.0: within a step, while the importer sets inputs, or reads */
  INPUT_UPDATE = 1 << 7,
  OUTPUT_UPDATE = 1 << 8
} flex_phase;

/* which instances have a function: those for co-simulation, those for model exchange, or both */
typedef enum { STEPPING = 1 << 0, EXCHANGE = 1 << 1, BOTH = STEPPING | EXCHANGE } flex_kind;

#define STEPPING_PHASE (STEP_COMPLETE | STEP_FAILED)
#define SOLVED_PHASE (EVENT_MODE | CONTINUOUS_TIME_MODE)
#define RUNNING_PHASE (STEPPING_PHASE | SOLVED_PHASE)
#define SETTABLE_PHASE (INSTANTIATED | INITIALISATION_MODE | STEPPING_PHASE | EVENT_MODE)
#define READABLE_PHASE (INITIALISATION_MODE | RUNNING_PHASE | TERMINATED)
#define ANY_PHASE (INSTANTIATED | READABLE_PHASE)
#define SHOWN_PHASE (ANY_PHASE | OUTPUT_UPDATE)

/* X(function, kinds, phases) */
#define FLEX_SHARED_CALLS(X)                                                 \
  X(fmi2SetDebugLogging, BOTH, ANY_PHASE)                                    \
  X(fmi2EnterInitializationMode, BOTH, INSTANTIATED)                         \
  X(fmi2ExitInitializationMode, BOTH, INITIALISATION_MODE)                   \
  X(fmi2Terminate, BOTH, RUNNING_PHASE)                                      \
  X(fmi2Reset, BOTH, ANY_PHASE)                                              \
  X(fmi2GetReal, BOTH, SHOWN_PHASE)                                          \
  X(fmi2GetInteger, BOTH, SHOWN_PHASE)                                       \
  X(fmi2SetReal, BOTH, SETTABLE_PHASE | CONTINUOUS_TIME_MODE | INPUT_UPDATE) \
  X(fmi2SetInteger, BOTH, SETTABLE_PHASE)                                    \
  X(fmi2GetFMUstate, BOTH, ANY_PHASE)                                        \
  X(fmi2SetFMUstate, BOTH, ANY_PHASE)                                        \
  X(fmi2FreeFMUstate, BOTH, ANY_PHASE)                                       \
  X(fmi2SerializedFMUstateSize, BOTH, ANY_PHASE)                             \
  X(fmi2SerializeFMUstate, BOTH, ANY_PHASE)                                  \
  X(fmi2DeSerializeFMUstate, BOTH, ANY_PHASE)                                \
  X(fmi2GetDirectionalDerivative, BOTH, READABLE_PHASE | OUTPUT_UPDATE)      \
  X(fmi2GetRealOutputDerivatives, STEPPING, READABLE_PHASE | OUTPUT_UPDATE)  \
  X(fmi2DoStep, STEPPING, STEPPING_PHASE)                                    \
  X(fmi2EnterContinuousTimeMode, EXCHANGE, EVENT_MODE)                       \
  X(fmi2CompletedIntegratorStep, EXCHANGE, CONTINUOUS_TIME_MODE)             \
  X(fmi2SetTime, EXCHANGE, SOLVED_PHASE)                                     \
  X(fmi2SetContinuousStates, EXCHANGE, CONTINUOUS_TIME_MODE)                 \
  X(fmi2GetDerivatives, EXCHANGE, READABLE_PHASE)                            \
  X(fmi2GetEventIndicators, EXCHANGE, READABLE_PHASE)                        \
  X(fmi2GetContinuousStates, EXCHANGE, READABLE_PHASE)                       \
  X(fmi2GetNominalsOfContinuousStates, EXCHANGE, ANY_PHASE)

#endif

/* Which FMI function may be called in which state of an instance: FMI 3.0, sections 2.3, 3.2 and 4.2.
 *
 * There is nothing to configure, so that this state does not exist. After an error the standard allows
 * no more than reading, rollback and reset; here the instance stays in its state. */
#ifndef FLEXFMU_FMI3_STATES_H
#define FLEXFMU_FMI3_STATES_H

#include "phases.h"

#define STEPPING_PHASE STEP_MODE
#define SHOWN_PHASE (ANY_PHASE | OUTPUT_UPDATE)

/* X(function, kinds, phases); what is missing is refused always, see fmi3_unsupported.c */
#define FLEX_FMI3_CALLS(X)                                                      \
  X(fmi3SetDebugLogging, BOTH, ANY_PHASE)                                       \
  X(fmi3EnterInitializationMode, BOTH, INSTANTIATED)                            \
  X(fmi3ExitInitializationMode, BOTH, INITIALISATION_MODE)                      \
  X(fmi3EnterEventMode, BOTH, STEP_MODE | CONTINUOUS_TIME_MODE)                 \
  X(fmi3Terminate, BOTH, RUNNING_PHASE)                                         \
  X(fmi3Reset, BOTH, ANY_PHASE)                                                 \
  X(fmi3GetFloat64, BOTH, SHOWN_PHASE)                                          \
  X(fmi3GetInt32, BOTH, SHOWN_PHASE)                                            \
  X(fmi3GetInt64, BOTH, SHOWN_PHASE)                                            \
  X(fmi3SetFloat64, BOTH, SETTABLE_PHASE | CONTINUOUS_TIME_MODE | INPUT_UPDATE) \
  X(fmi3SetInt32, BOTH, SETTABLE_PHASE)                                         \
  X(fmi3SetInt64, BOTH, SETTABLE_PHASE)                                         \
  X(fmi3GetFMUState, BOTH, ANY_PHASE)                                           \
  X(fmi3SetFMUState, BOTH, ANY_PHASE)                                           \
  X(fmi3FreeFMUState, BOTH, ANY_PHASE)                                          \
  X(fmi3SerializedFMUStateSize, BOTH, ANY_PHASE)                                \
  X(fmi3SerializeFMUState, BOTH, ANY_PHASE)                                     \
  X(fmi3DeserializeFMUState, BOTH, ANY_PHASE)                                   \
  X(fmi3GetDirectionalDerivative, BOTH, READABLE_PHASE | OUTPUT_UPDATE)         \
  X(fmi3GetAdjointDerivative, BOTH, READABLE_PHASE | OUTPUT_UPDATE)             \
  X(fmi3SetClock, BOTH, EVENT_MODE)                                             \
  X(fmi3UpdateDiscreteStates, BOTH, EVENT_MODE)                                 \
  X(fmi3EnterContinuousTimeMode, EXCHANGE, EVENT_MODE)                          \
  X(fmi3CompletedIntegratorStep, EXCHANGE, CONTINUOUS_TIME_MODE)                \
  X(fmi3SetTime, EXCHANGE, SOLVED_PHASE)                                        \
  X(fmi3SetContinuousStates, EXCHANGE, CONTINUOUS_TIME_MODE)                    \
  X(fmi3GetContinuousStateDerivatives, EXCHANGE, READABLE_PHASE)                \
  X(fmi3GetEventIndicators, EXCHANGE, READABLE_PHASE)                           \
  X(fmi3GetContinuousStates, EXCHANGE, READABLE_PHASE)                          \
  X(fmi3GetNominalsOfContinuousStates, EXCHANGE, ANY_PHASE)                     \
  X(fmi3GetNumberOfEventIndicators, EXCHANGE, ANY_PHASE)                        \
  X(fmi3GetNumberOfContinuousStates, EXCHANGE, ANY_PHASE)                       \
  X(fmi3EnterStepMode, STEPPING, EVENT_MODE)                                    \
  X(fmi3GetOutputDerivatives, STEPPING, READABLE_PHASE | OUTPUT_UPDATE)         \
  X(fmi3DoStep, STEPPING, STEP_MODE)

/* call_fmi3DoStep and so on */
typedef enum {
#define X(function, kinds, phases) call_##function,
  FLEX_FMI3_CALLS(X)
#undef X
} flex_call_id;

#endif

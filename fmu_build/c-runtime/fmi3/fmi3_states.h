/* Which function of FMI 3.0 alone may be called in which state of an instance: FMI 3.0, sections 2.3, 3.2 and 4.2.
 *
 * There is nothing to configure, so that this state does not exist. After an error the standard allows
 * no more than reading, rollback and reset; here the instance stays in its state. */
#ifndef FLEXFMU_FMI3_STATES_H
#define FLEXFMU_FMI3_STATES_H

#include "phases.h"

/* what is missing is refused always, see fmi3_unsupported.c */
#define FLEX_FMI3_CALLS(X)                                              \
  FLEX_SHARED_CALLS(X)                                                  \
  X(fmi3EnterEventMode, BOTH, STEP_MODE | CONTINUOUS_TIME_MODE)         \
  X(fmi3UpdateDiscreteStates, BOTH, EVENT_MODE)                         \
  X(fmi3GetInt64, BOTH, SHOWN_PHASE)                                    \
  X(fmi3SetInt64, BOTH, SETTABLE_PHASE)                                 \
  X(fmi3GetAdjointDerivative, BOTH, READABLE_PHASE | OUTPUT_UPDATE)     \
  X(fmi3SetClock, BOTH, EVENT_MODE)                                     \
  X(fmi3GetNumberOfEventIndicators, EXCHANGE, ANY_PHASE)                \
  X(fmi3GetNumberOfContinuousStates, EXCHANGE, ANY_PHASE)               \
  X(fmi3EnterStepMode, STEPPING, EVENT_MODE)

#endif

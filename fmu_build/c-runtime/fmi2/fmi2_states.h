/* Which function of FMI 2.0 alone may be called in which state of an instance: the tables of FMI 2.0.4, sections 3.2.3 (model
 * exchange) and 4.2.4 (co-simulation).
 *
 * There are no asynchronous steps, so that the states "step in progress" and "step canceled" do not exist. Beyond the
 * table, inputs may be set and a step may be tried after a failed one: the instance is at the last successful time then. */
#ifndef FLEXFMU_FMI2_STATES_H
#define FLEXFMU_FMI2_STATES_H

#include "phases.h"

#define STEPPED_PHASE (STEPPING_PHASE | TERMINATED)

#define FLEX_FMI2_CALLS(X)                                 \
  FLEX_SHARED_CALLS(X)                                     \
  X(fmi2EnterEventMode, EXCHANGE, SOLVED_PHASE)            \
  X(fmi2NewDiscreteStates, EXCHANGE, EVENT_MODE)           \
  X(fmi2SetupExperiment, BOTH, INSTANTIATED)               \
  X(fmi2GetBoolean, BOTH, READABLE_PHASE)                  \
  X(fmi2GetString, BOTH, READABLE_PHASE)                   \
  X(fmi2SetBoolean, BOTH, SETTABLE_PHASE)                  \
  X(fmi2SetString, BOTH, SETTABLE_PHASE)                   \
  X(fmi2SetRealInputDerivatives, STEPPING, SETTABLE_PHASE) \
  X(fmi2CancelStep, STEPPING, 0)                           \
  X(fmi2GetStatus, STEPPING, STEPPED_PHASE)                \
  X(fmi2GetRealStatus, STEPPING, STEPPED_PHASE)            \
  X(fmi2GetIntegerStatus, STEPPING, STEPPED_PHASE)         \
  X(fmi2GetBooleanStatus, STEPPING, STEPPED_PHASE)         \
  X(fmi2GetStringStatus, STEPPING, STEPPED_PHASE)

#endif

/* Communication steps and events. */
#include <string.h>

#include "instance.h"

/* Events within a step are handled within it, unless the importer lets steps return early. A step that fails is discarded: as the standard demands, everything is as it was
 * before. */
fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
  (void)noSetFMUStatePriorToCurrentPoint;
  const flex_call_id call = call_fmi3DoStep;
  flex_instance *ours = flex_checked(instance, call);
  if (!ours || flex_lacks(ours, call, "a place for eventHandlingNeeded", eventHandlingNeeded, 1) ||
      flex_lacks(ours, call, "a place for terminateSimulation", terminateSimulation, 1) ||
      flex_lacks(ours, call, "a place for earlyReturn", earlyReturn, 1) ||
      flex_lacks(ours, call, "a place for lastSuccessfulTime", lastSuccessfulTime, 1) ||
      flex_step_is_impossible(ours, currentCommunicationPoint, communicationStepSize))
    return fmi3Error;

  flex_backend *backend = ours->backend;
  memcpy(ours->before, backend->state, backend->state_size);
  double end = currentCommunicationPoint + communicationStepSize;
  fmi3Status status = fmi3OK;
  int event = 0;
  if (flex_backend_advance(backend, currentCommunicationPoint, end, ours->session.returns_early ? &event : NULL)) {
    status = flex_log(ours, fmi3Discard, LOG_DISCARD, "%s", backend->message);
    memcpy(backend->state, ours->before, backend->state_size);
    flex_backend_restored(backend);
  }
  *terminateSimulation = fmi3False;
  *eventHandlingNeeded = event != 0 && status == fmi3OK;
  *earlyReturn = *eventHandlingNeeded && *backend->time < end;
  *lastSuccessfulTime = *backend->time;
  return status;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime) {
  flex_instance *ours = flex_checked(instance, call_fmi3UpdateDiscreteStates);
  if (!ours) return fmi3Error;
  fmi3Boolean *const flags[] = {discreteStatesNeedUpdate, terminateSimulation, nominalsOfContinuousStatesChanged,
                                valuesOfContinuousStatesChanged, nextEventTimeDefined};
  int lacks = flex_lacks(ours, call_fmi3UpdateDiscreteStates, "a place for nextEventTime", nextEventTime, 1);
  for (size_t i = 0; i < sizeof flags / sizeof *flags && !lacks; i++)
    lacks = flex_lacks(ours, call_fmi3UpdateDiscreteStates, "a place for what happened", flags[i], 1);
  if (lacks) return fmi3Error;

  int states_changed = 0, is_exchange = ours->session.kind == EXCHANGE;
  if (flex_backend_handle_event(ours->backend, is_exchange, &states_changed)) return flex_log_refusal(ours);
  for (size_t i = 0; i < sizeof flags / sizeof *flags; i++) *flags[i] = fmi3False;
  *valuesOfContinuousStatesChanged = states_changed != 0;
  return fmi3OK;
}

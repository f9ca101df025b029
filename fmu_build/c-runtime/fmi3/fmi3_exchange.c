/* The functions for model exchange: the importer integrates. Our own events are those of friction. */
#include <math.h>

#include "fmi3_instance.h"

// the instance if the call is legal and its array of states or the like has the right size, else NULL
static flex_instance *checked(fmi3Instance instance, flex_call_id call, const char *what, const void *array, size_t size,
                              size_t needed) {
  flex_instance *ours = flex_checked(instance, call);
  return ours && !flex_misfits(ours, call, what, array, size, needed) ? ours : NULL;
}

// a smaller step may avoid a point at which nothing can be computed
static fmi3Status discarded(const flex_instance *ours, int is_refused) {
  return is_refused ? flex_log(ours, fmi3Discard, LOG_DISCARD, "%s", ours->backend->message) : fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation) {
  (void)noSetFMUStatePriorToCurrentPoint;
  const flex_call_id call = call_fmi3CompletedIntegratorStep;
  flex_instance *ours = flex_checked(instance, call);
  if (!ours || flex_lacks(ours, call, "a place for enterEventMode", enterEventMode, 1) ||
      flex_lacks(ours, call, "a place for terminateSimulation", terminateSimulation, 1))
    return fmi3Error;
  *enterEventMode = *terminateSimulation = fmi3False;
  if (flex_backend_check_point(ours->backend)) return flex_log_refusal(ours);
  *enterEventMode = flex_backend_has_event(ours->backend) != 0;
  return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
  flex_instance *ours = flex_checked(instance, call_fmi3SetTime);
  if (!ours) return fmi3Error;
  if (!isfinite(time)) return flex_log(ours, fmi3Error, LOG_ERROR, "the time must be finite, got %g s", time);
  flex_backend_set_time(ours->backend, time);
  return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[], size_t nContinuousStates) {
  flex_instance *ours = checked(instance, call_fmi3SetContinuousStates, "continuous states", continuousStates,
                                nContinuousStates, flex_backend_states());
  if (!ours) return fmi3Error;
  for (size_t i = 0; i < nContinuousStates; i++)
    if (!isfinite(continuousStates[i]))
      return flex_log(ours, fmi3Error, LOG_ERROR, "continuous state %lu must be finite, got %g at %.9g s", (unsigned long)i,
                      continuousStates[i], *ours->backend->time);
  flex_backend_set_states(ours->backend, continuousStates);
  return fmi3OK;
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t nContinuousStates) {
  flex_instance *ours = checked(instance, call_fmi3GetContinuousStateDerivatives, "state derivatives", derivatives,
                                nContinuousStates, flex_backend_states());
  return ours ? discarded(ours, flex_backend_get_state_rates(ours->backend, derivatives)) : fmi3Error;
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators) {
  flex_instance *ours = checked(instance, call_fmi3GetEventIndicators, "event indicators", eventIndicators, nEventIndicators,
                                flex_backend_indicators());
  if (!ours) return fmi3Error;
  return nEventIndicators ? discarded(ours, flex_backend_get_indicators(ours->backend, eventIndicators)) : fmi3OK;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates) {
  flex_instance *ours = checked(instance, call_fmi3GetContinuousStates, "continuous states", continuousStates,
                                nContinuousStates, flex_backend_states());
  if (!ours) return fmi3Error;
  return flex_backend_get_states(ours->backend, continuousStates) ? flex_log_refusal(ours) : fmi3OK;
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates) {
  if (!checked(instance, call_fmi3GetNominalsOfContinuousStates, "nominal values", nominals, nContinuousStates,
               flex_backend_states()))
    return fmi3Error;
  for (size_t i = 0; i < nContinuousStates; i++) nominals[i] = flex_backend_state_nominal(i);
  return fmi3OK;
}

static fmi3Status count(fmi3Instance instance, flex_call_id call, size_t *place, size_t number) {
  flex_instance *ours = flex_checked(instance, call);
  if (!ours || flex_lacks(ours, call, "a place for the number", place, 1)) return fmi3Error;
  *place = number;
  return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators) {
  return count(instance, call_fmi3GetNumberOfEventIndicators, nEventIndicators, flex_backend_indicators());
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates) {
  return count(instance, call_fmi3GetNumberOfContinuousStates, nContinuousStates, flex_backend_states());
}

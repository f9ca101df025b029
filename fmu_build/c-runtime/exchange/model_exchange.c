/* The functions of FMI for model exchange: the importer integrates. Our own events are those of friction. */
#include <math.h>

#include "instance.h"

// the instance if the call is legal and its array of states or the like has the right size, else NULL
static flex_instance *checked(fmi2Component c, flex_call_id call, const char *what, const void *array, size_t size,
                              size_t needed) {
  flex_instance *instance = flex_checked(c, call);
  return instance && !flex_misfits(instance, call, what, array, size, needed) ? instance : NULL;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
  return flex_enter_phase(c, call_fmi2EnterContinuousTimeMode, CONTINUOUS_TIME_MODE);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
  (void)noSetFMUStatePriorToCurrentPoint;
  const flex_call_id call = call_fmi2CompletedIntegratorStep;
  flex_instance *instance = flex_checked(c, call);
  if (!instance || flex_lacks(instance, call, "a place for enterEventMode", enterEventMode, 1) ||
      flex_lacks(instance, call, "a place for terminateSimulation", terminateSimulation, 1))
    return fmi2Error;
  *enterEventMode = *terminateSimulation = fmi2False;
  if (flex_backend_check_point(instance->backend)) return flex_log_refusal(instance);
  *enterEventMode = flex_backend_has_event(instance->backend);
  return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
  flex_instance *instance = flex_checked(c, call_fmi2SetTime);
  if (!instance) return fmi2Error;
  if (!isfinite(time)) return flex_log(instance, fmi2Error, LOG_ERROR, "the time must be finite, got %g s", time);
  flex_backend_set_time(instance->backend, time);
  return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
  flex_instance *instance = checked(c, call_fmi2SetContinuousStates, "continuous states", x, nx, flex_backend_states());
  if (!instance) return fmi2Error;
  for (size_t i = 0; i < nx; i++)
    if (!isfinite(x[i]))
      return flex_log(instance, fmi2Error, LOG_ERROR, "continuous state %lu must be finite, got %g at %.9g s",
                      (unsigned long)i, x[i], *instance->backend->time);
  flex_backend_set_states(instance->backend, x);
  return fmi2OK;
}

// a smaller step may avoid a point at which nothing can be computed
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
  const size_t needed = flex_backend_states();
  flex_instance *instance = checked(c, call_fmi2GetDerivatives, "state derivatives", derivatives, nx, needed);
  if (!instance) return fmi2Error;
  if (!flex_backend_get_state_rates(instance->backend, derivatives)) return fmi2OK;
  return flex_log(instance, fmi2Discard, LOG_DISCARD, "%s", instance->backend->message);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
  const size_t needed = flex_backend_indicators();
  flex_instance *instance = checked(c, call_fmi2GetEventIndicators, "event indicators", eventIndicators, ni, needed);
  if (!instance) return fmi2Error;
  if (needed == 0 || !flex_backend_get_indicators(instance->backend, eventIndicators)) return fmi2OK;
  return flex_log(instance, fmi2Discard, LOG_DISCARD, "%s", instance->backend->message);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
  flex_instance *instance = checked(c, call_fmi2GetContinuousStates, "continuous states", x, nx, flex_backend_states());
  if (!instance) return fmi2Error;
  return flex_backend_get_states(instance->backend, x) ? flex_log_refusal(instance) : fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
  const size_t needed = flex_backend_states();
  if (!checked(c, call_fmi2GetNominalsOfContinuousStates, "nominal values", x_nominal, nx, needed)) return fmi2Error;
  for (size_t i = 0; i < nx; i++) x_nominal[i] = flex_backend_state_nominal(i);
  return fmi2OK;
}

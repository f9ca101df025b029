/* Event mode, which is another in FMI 3.0. */
#include <math.h>

#include "instance.h"

fmi2Status fmi2EnterEventMode(fmi2Component c) {
  return flex_enter_phase(c, call_fmi2EnterEventMode, EVENT_MODE);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo) {
  fmi2EventInfo info = {fmi2False, fmi2False, fmi2False, fmi2False, fmi2False, 0.0};
  flex_instance *instance = flex_checked(c, call_fmi2NewDiscreteStates);
  if (!instance || flex_lacks(instance, call_fmi2NewDiscreteStates, "a place for what happened", eventInfo, 1))
    return fmi2Error;
  if (flex_backend_handle_event(instance->backend, 1, &info.valuesOfContinuousStatesChanged, &info.nextEventTime))
    return flex_log_refusal(instance);
  info.nextEventTimeDefined = info.nextEventTime < HUGE_VAL;
  *eventInfo = info;
  return fmi2OK;
}

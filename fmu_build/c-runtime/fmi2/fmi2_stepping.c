/* Communication steps and their status. */
#include <string.h>

#include "instance.h"

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
  (void)noSetFMUStatePriorToCurrentPoint;
  flex_instance *instance = flex_checked(c, call_fmi2DoStep);
  if (!instance || flex_step_is_impossible(instance, currentCommunicationPoint, communicationStepSize)) return fmi2Error;

  double end = currentCommunicationPoint + communicationStepSize;
  int is_refused = flex_backend_advance(instance->backend, currentCommunicationPoint, end, NULL);
  flex_enter_phase(instance, is_refused ? STEP_FAILED : STEP_COMPLETE);
  instance->session.last_step = is_refused ? fmi2Discard : fmi2OK;
  instance->reason[0] = '\0';
  if (!is_refused) return fmi2OK;
  memcpy(instance->reason, instance->backend->message, strlen(instance->backend->message) + 1);
  return flex_log(instance, fmi2Discard, LOG_DISCARD, "%s", instance->reason);
}

fmi2Status fmi2CancelStep(fmi2Component c) {
  flex_checked(c, call_fmi2CancelStep);
  return fmi2Error;
}

// a question that has no answer
static fmi2Status no_such_status(const flex_instance *instance, const char *function, int kind) {
  return flex_log(instance, fmi2Discard, LOG_DISCARD, "%s has no status of kind %d", function, kind);
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
  flex_instance *instance = flex_checked(c, call_fmi2GetStatus);
  if (!instance || flex_lacks(instance, call_fmi2GetStatus, "a place for the answer", value, 1)) return fmi2Error;
  if (s != fmi2DoStepStatus) return no_such_status(instance, "fmi2GetStatus", (int)s);
  *value = (fmi2Status)instance->session.last_step;
  return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
  flex_instance *instance = flex_checked(c, call_fmi2GetRealStatus);
  if (!instance || flex_lacks(instance, call_fmi2GetRealStatus, "a place for the answer", value, 1)) return fmi2Error;
  if (s != fmi2LastSuccessfulTime) return no_such_status(instance, "fmi2GetRealStatus", (int)s);
  *value = *instance->backend->time;
  return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
  (void)value;
  flex_instance *instance = flex_checked(c, call_fmi2GetIntegerStatus);
  return instance ? no_such_status(instance, "fmi2GetIntegerStatus", (int)s) : fmi2Error;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
  flex_instance *instance = flex_checked(c, call_fmi2GetBooleanStatus);
  if (!instance || flex_lacks(instance, call_fmi2GetBooleanStatus, "a place for the answer", value, 1)) return fmi2Error;
  if (s != fmi2Terminated) return no_such_status(instance, "fmi2GetBooleanStatus", (int)s);
  *value = fmi2False;
  return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value) {
  flex_instance *instance = flex_checked(c, call_fmi2GetStringStatus);
  if (!instance || flex_lacks(instance, call_fmi2GetStringStatus, "a place for the answer", value, 1)) return fmi2Error;
  if (s != fmi2PendingStatus) return no_such_status(instance, "fmi2GetStringStatus", (int)s);
  *value = instance->reason[0] ? instance->reason : "no step is pending";
  return fmi2OK;
}

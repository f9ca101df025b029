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
  instance->session.phase = is_refused ? STEP_FAILED : STEP_COMPLETE;
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

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
  (void)value;
  flex_instance *instance = flex_checked(c, call_fmi2GetIntegerStatus);
  return instance ? no_such_status(instance, "fmi2GetIntegerStatus", (int)s) : fmi2Error;
}

/* the function of a type, the one question that it answers, and its answer */
#define STATUS(type, function, question, answer)                                                               \
  fmi2Status function(fmi2Component c, const fmi2StatusKind s, type *value) {                                  \
    flex_instance *instance = flex_checked(c, call_##function);                                                \
    if (!instance || flex_lacks(instance, call_##function, "a place for the answer", value, 1)) return fmi2Error; \
    if (s != question) return no_such_status(instance, #function, (int)s);                                     \
    *value = answer;                                                                                           \
    return fmi2OK;                                                                                             \
  }

STATUS(fmi2Status, fmi2GetStatus, fmi2DoStepStatus, (fmi2Status)instance->session.last_step)
STATUS(fmi2Real, fmi2GetRealStatus, fmi2LastSuccessfulTime, *instance->backend->time)
STATUS(fmi2Boolean, fmi2GetBooleanStatus, fmi2Terminated, fmi2False)
STATUS(fmi2String, fmi2GetStringStatus, fmi2PendingStatus, instance->reason[0] ? instance->reason : "no step is pending")

#include "fmi2_instance.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

const char *const flex_log_categories[N_LOG_CATEGORIES] = {"logStatusError", "logStatusWarning", "logStatusDiscard",
                                                           "logStatusFatal", "statistics"};

static const struct {
  const char *name;
  int kinds, phases;
} calls[] = {
#define X(function, kinds, phases) {#function, kinds, phases},
    FLEX_FMI2_CALLS(X)
#undef X
};

static const char *phase_name(flex_phase phase) {
  switch (phase) {
    case INSTANTIATED: return "instantiated";
    case INITIALISATION_MODE: return "initialization mode";
    case STEP_COMPLETE: return "step complete";
    case STEP_FAILED: return "step failed";
    case TERMINATED: return "terminated";
    case EVENT_MODE: return "event mode";
    case CONTINUOUS_TIME_MODE: return "continuous-time mode";
  }
  return "unknown";
}

fmi2Status flex_log(const flex_instance *instance, fmi2Status status, flex_log_category category, const char *format, ...) {
  if (!instance->callbacks.logger || !instance->logged[category]) return status;
  char text[FLEX_MESSAGE_SIZE], escaped[2 * FLEX_MESSAGE_SIZE];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);

  // the importer reads the sentence as a format
  char *out = escaped;
  for (const char *in = text; *in; in++) {
    if (*in == '%') *out++ = '%';
    *out++ = *in;
  }
  *out = '\0';
  instance->callbacks.logger(instance->callbacks.componentEnvironment, instance->name, status, flex_log_categories[category],
                             escaped);
  return status;
}

fmi2Status flex_log_refusal(const flex_instance *instance) {
  return flex_log(instance, fmi2Error, LOG_ERROR, "%s", instance->backend->message);
}

flex_phase flex_phase_of(const flex_instance *instance) {
  return (flex_phase)instance->session.phase;
}

void flex_enter_phase(flex_instance *instance, flex_phase phase) {
  instance->session.phase = (int)phase;
}

flex_instance *flex_checked(fmi2Component component, flex_call_id call) {
  flex_instance *instance = component;
  if (!instance) return NULL;
  if (!(calls[call].kinds & instance->session.kind)) {
    flex_log(instance, fmi2Error, LOG_ERROR, "%s must not be called: this instance was made for %s", calls[call].name,
             instance->session.kind == EXCHANGE ? "model exchange" : "co-simulation");
    return NULL;
  }
  if (calls[call].phases & (int)flex_phase_of(instance)) return instance;
  flex_log(instance, fmi2Error, LOG_ERROR, "%s must not be called in the state '%s'", calls[call].name,
           phase_name(flex_phase_of(instance)));
  return NULL;
}

int flex_lacks(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count) {
  if (place || count == 0) return 0;
  flex_log(instance, fmi2Error, LOG_ERROR, "%s needs %s, got a null pointer", calls[call].name, what);
  return 1;
}

void *flex_allocate(const fmi2CallbackFunctions *callbacks, size_t size) {
  return callbacks->allocateMemory ? callbacks->allocateMemory(1, size) : calloc(1, size);
}

void flex_release(const fmi2CallbackFunctions *callbacks, void *memory) {
  if (callbacks->freeMemory)
    callbacks->freeMemory(memory);
  else
    free(memory);
}

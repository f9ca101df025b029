#include "fmi3_instance.h"

#include <stdarg.h>
#include <stdio.h>

const char *const flex_log_categories[N_LOG_CATEGORIES] = {"logStatusError", "logStatusWarning", "logStatusDiscard",
                                                           "logStatusFatal", "statistics"};

static const struct {
  const char *name;
  int kinds, phases;
} calls[] = {
#define X(function, kinds, phases) {#function, kinds, phases},
    FLEX_FMI3_CALLS(X)
#undef X
};

static const char *phase_name(int phase) {
  switch (phase) {
    case INSTANTIATED: return "instantiated";
    case INITIALISATION_MODE: return "initialization mode";
    case STEP_MODE: return "step mode";
    case EVENT_MODE: return "event mode";
    case CONTINUOUS_TIME_MODE: return "continuous-time mode";
    case TERMINATED: return "terminated";
  }
  return "unknown";
}

fmi3Status flex_log(const flex_instance *instance, fmi3Status status, flex_log_category category, const char *format, ...) {
  if (!instance->logger || (status < fmi3Error && !instance->logged[category])) return status;
  char text[FLEX_MESSAGE_SIZE], escaped[2 * FLEX_MESSAGE_SIZE];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);

  // a single # would begin a value reference
  char *out = escaped;
  for (const char *in = text; *in; in++) {
    if (*in == '#') *out++ = '#';
    *out++ = *in;
  }
  *out = '\0';
  instance->logger(instance->environment, status, flex_log_categories[category], escaped);
  return status;
}

fmi3Status flex_log_refusal(const flex_instance *instance) {
  return flex_log(instance, fmi3Error, LOG_ERROR, "%s", instance->backend->message);
}

void flex_enter_phase(flex_instance *instance, flex_phase phase) {
  instance->session.phase = (int)phase;
}

flex_instance *flex_checked(fmi3Instance pointer, flex_call_id call) {
  flex_instance *instance = pointer;
  if (!instance) return NULL;
  const flex_session *session = &instance->session;
  if (!(calls[call].kinds & session->kind))
    flex_log(instance, fmi3Error, LOG_ERROR, "%s must not be called: this instance was made for %s", calls[call].name,
             session->kind == EXCHANGE ? "model exchange" : "co-simulation");
  else if (!(calls[call].phases & session->phase))
    flex_log(instance, fmi3Error, LOG_ERROR, "%s must not be called in the state '%s'", calls[call].name,
             phase_name(session->phase));
  else
    return instance;
  return NULL;
}

int flex_lacks(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count) {
  if (place || count == 0) return 0;
  flex_log(instance, fmi3Error, LOG_ERROR, "%s needs %s, got a null pointer", calls[call].name, what);
  return 1;
}

int flex_misfits(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count,
                 size_t needed) {
  if (flex_lacks(instance, call, what, place, count)) return 1;
  if (count == needed) return 0;
  flex_log(instance, fmi3Error, LOG_ERROR, "%s needs %lu %s, got an array of %lu", calls[call].name, (unsigned long)needed, what,
           (unsigned long)count);
  return 1;
}

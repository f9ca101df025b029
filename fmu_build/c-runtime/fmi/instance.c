/* What both versions of FMI share of an instance's life. It is written in the words of FMI 2.0, like all files beside it; the build makes
 * those of FMI 3.0 of them. */
#include "instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "clock.h"

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

static const char *phase_name(int phase) {
  switch (phase) {
    case INSTANTIATED: return "instantiated";
    case INITIALISATION_MODE: return "initialization mode";
    case STEP_COMPLETE: return "step complete";
    case STEP_FAILED: return "step failed";
    case TERMINATED: return "terminated";
    case EVENT_MODE: return "event mode";
    case CONTINUOUS_TIME_MODE: return "continuous-time mode";
    case INPUT_UPDATE: return "intermediate update of inputs";
    case OUTPUT_UPDATE: return "intermediate update";
  }
  return "unknown";
}

fmi2Status flex_log(const flex_instance *instance, fmi2Status status, flex_log_category category, const char *format, ...) {
  if (!instance->logged[category] && !FLEX_IS_ALWAYS_LOGGED(status)) return status;
  char text[FLEX_MESSAGE_SIZE], escaped[2 * FLEX_MESSAGE_SIZE];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);

  // the importer reads the sentence as a format, or finds value references in it
  char *out = escaped;
  for (const char *in = text; *in; in++) {
    if (*in == FLEX_ESCAPED) *out++ = *in;
    *out++ = *in;
  }
  *out = '\0';
  flex_hand_over(&instance->callbacks, instance->name, status, flex_log_categories[category], escaped);
  return status;
}

fmi2Status flex_log_refusal(const flex_instance *instance) {
  return flex_log(instance, fmi2Error, LOG_ERROR, "%s", instance->backend->message);
}

flex_instance *flex_checked(fmi2Component component, flex_call_id call) {
  flex_instance *instance = component;
  if (!instance) return NULL;
  if (!(calls[call].kinds & instance->session.kind)) {
    flex_log(instance, fmi2Error, LOG_ERROR, "%s must not be called: this instance was made for %s", calls[call].name,
             instance->session.kind == EXCHANGE ? "model exchange" : "co-simulation");
    return NULL;
  }
  if (calls[call].phases & instance->session.phase) return instance;
  flex_log(instance, fmi2Error, LOG_ERROR, "%s must not be called in the state '%s'", calls[call].name,
           phase_name(instance->session.phase));
  return NULL;
}

int flex_lacks(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count) {
  if (place || count == 0) return 0;
  flex_log(instance, fmi2Error, LOG_ERROR, "%s needs %s, got a null pointer", calls[call].name, what);
  return 1;
}

int flex_misfits(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count,
                 size_t needed) {
  if (flex_lacks(instance, call, what, place, count)) return 1;
  if (count == needed) return 0;
  flex_log(instance, fmi2Error, LOG_ERROR, "%s needs %lu %s, got an array of %lu", calls[call].name, (unsigned long)needed, what,
           (unsigned long)count);
  return 1;
}

fmi2Status flex_enter_phase(fmi2Component component, flex_call_id call, flex_phase phase) {
  flex_instance *instance = flex_checked(component, call);
  if (!instance) return fmi2Error;
  instance->session.phase = (int)phase;
  return fmi2OK;
}

// why an instance of a kind cannot be made with these; NULL if it can
static const char *obstacle(const char *name, flex_kind kind, const char *guid) {
  if (!name || !*name) return "an instance needs a name, got an empty one";
  if (kind == EXCHANGE && !flex_backend_has_model_exchange())
    return "this FMU supports co-simulation only, not model exchange";
  if (!guid || strcmp(guid, flex_backend_guid()) != 0)
    return "the GUID differs from that of the binary; modelDescription.xml and binary do not belong together";
  return NULL;
}

// instance, name and backend in one block of memory
static flex_instance *create(const char *name, const flex_callbacks *callbacks) {
  flex_arena measure = {NULL, 0};
  size_t name_size = strlen(name) + 1;
  flex_take(&measure, sizeof(flex_instance));
  flex_take(&measure, name_size);
  char *block = flex_allocate(callbacks, measure.used + flex_backend_size());
  if (!block) return NULL;

  // an importer's allocateMemory need not clear
  memset(block, 0, measure.used + flex_backend_size());
  flex_arena arena = {block, 0};
  flex_instance *instance = flex_take(&arena, sizeof *instance);
  instance->name = memcpy(flex_take(&arena, name_size), name, name_size);
  instance->callbacks = *callbacks;
  instance->backend = flex_backend_create(block + arena.used);
  return instance;
}

flex_instance *flex_instantiate(const char *name, flex_kind kind, const char *guid, int is_logging,
                                const flex_callbacks *callbacks) {
  const char *why_not = obstacle(name, kind, guid);
  flex_instance *instance = why_not ? NULL : create(name, callbacks);
  if (!why_not && !instance) why_not = "out of memory";
  if (why_not) {
    flex_hand_over(callbacks, name ? name : "", fmi2Error, flex_log_categories[LOG_ERROR], why_not);
    return NULL;
  }
  for (int i = 0; i < N_LOG_CATEGORIES; i++) instance->logged[i] = is_logging || FLEX_IS_SHOWN(i);
  instance->session.kind = kind;
  instance->session.phase = INSTANTIATED;
  return instance;
}

void fmi2FreeInstance(fmi2Component c) {
  flex_instance *instance = c;
  if (!instance) return;
  const flex_callbacks callbacks = instance->callbacks;
  flex_release_states(instance);
  if (instance->scratch) flex_release(&callbacks, instance->scratch);
  flex_release(&callbacks, instance);
}

static int category_index(const char *name) {
  for (int i = 0; i < N_LOG_CATEGORIES; i++)
    if (name && strcmp(name, flex_log_categories[i]) == 0) return i;
  return -1;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[]) {
  flex_instance *instance = flex_checked(c, call_fmi2SetDebugLogging);
  if (!instance) return fmi2Error;
  if (flex_lacks(instance, call_fmi2SetDebugLogging, "log categories", categories, nCategories)) return fmi2Error;
  for (size_t i = 0; i < nCategories; i++)
    if (category_index(categories[i]) < 0)
      return flex_log(instance, fmi2Error, LOG_ERROR, "log category '%s' is unknown; there are %s, %s, %s, %s and %s",
                      categories[i] ? categories[i] : "", flex_log_categories[0], flex_log_categories[1],
                      flex_log_categories[2], flex_log_categories[3], flex_log_categories[4]);
  if (nCategories == 0)
    for (int i = 0; i < N_LOG_CATEGORIES; i++) instance->logged[i] = loggingOn != 0;
  for (size_t i = 0; i < nCategories; i++) instance->logged[category_index(categories[i])] = loggingOn != 0;
  return fmi2OK;
}

fmi2Status flex_set_up(flex_instance *instance, int has_tolerance, double tolerance, double start, int has_stop, double stop) {
  if (has_tolerance && !(tolerance > 0.0 && tolerance < 1.0))
    return flex_log(instance, fmi2Error, LOG_ERROR, "the relative tolerance must be between 0 and 1, got %g", tolerance);
  if (!isfinite(start))
    return flex_log(instance, fmi2Error, LOG_ERROR, "the start time must be finite, got %g s", start);
  if (has_stop && !(stop > start))
    return flex_log(instance, fmi2Error, LOG_ERROR, "the stop time must be after the start time %g s, got %g s", start,
                    stop);

  flex_backend_set_start_time(instance->backend, start);
  instance->session.has_stop_time = has_stop != 0;
  instance->session.stop_time = has_stop ? stop : 0.0;
  if (!has_tolerance) return fmi2OK;
  double used = flex_backend_set_tolerance(instance->backend, tolerance);
  if (used == tolerance) return fmi2OK;
  return flex_log(instance, fmi2Warning, LOG_WARNING, "the relative tolerance %g is beyond double precision, %g is used",
                  tolerance, used);
}

int flex_step_is_impossible(const flex_instance *instance, double point, double step) {
  const flex_session *session = &instance->session;
  double present = *instance->backend->time;
  if (!isfinite(point) || !isfinite(step) || !(step > 0.0))
    flex_log(instance, fmi2Error, LOG_ERROR, "the communication step size must be positive and finite, got %g s at %.9g s",
             step, point);
  else if (fabs(point - present) > flex_time_slack(present, step))
    flex_log(instance, fmi2Error, LOG_ERROR, "the communication point must be the present time %.17g s, got %.17g s", present,
             point);
  else if (!isfinite(point + step))
    flex_log(instance, fmi2Error, LOG_ERROR, "a communication step of %g s from %.17g s has no finite end", step, point);
  else if (!(point + step > point))
    flex_log(instance, fmi2Error, LOG_ERROR, "a communication step of %g s is lost by rounding at %.17g s", step, point);
  else if (session->has_stop_time && point + step > session->stop_time + flex_time_slack(session->stop_time, step))
    flex_log(instance, fmi2Error, LOG_ERROR, "a step of %g s from %.17g s goes beyond the stop time %.17g s", step, point,
             session->stop_time);
  else
    return 0;
  return 1;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2ExitInitializationMode);
  if (!instance) return fmi2Error;
  if (flex_backend_begin(instance->backend)) return flex_log_refusal(instance);
  instance->session.phase = instance->session.kind == EXCHANGE || instance->session.has_events ? EVENT_MODE : STEP_COMPLETE;
  return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2Terminate);
  if (!instance) return fmi2Error;
  char text[FLEX_MESSAGE_SIZE];
  flex_backend_summarise(instance->backend, text, sizeof text);
  flex_log(instance, fmi2OK, LOG_STATISTICS, "%s", text);
  instance->session.phase = TERMINATED;
  return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2Reset);
  if (!instance) return fmi2Error;
  flex_backend_reset(instance->backend);
  const flex_session *old = &instance->session;
  const flex_session fresh = {
      .phase = INSTANTIATED, .kind = old->kind, .has_events = old->has_events, .returns_early = old->returns_early};
  instance->session = fresh;
  instance->reason[0] = '\0';
  return fmi2OK;
}

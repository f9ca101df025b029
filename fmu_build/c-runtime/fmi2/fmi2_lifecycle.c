/* Creation, modes and end of an instance. */
#include <math.h>
#include <string.h>

#include "fmi2_instance.h"

const char *fmi2GetTypesPlatform(void) {
  return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void) {
  return fmi2Version;
}

// instance, name and backend in one block of memory
static flex_instance *create(const char *name, flex_kind kind, const fmi2CallbackFunctions *callbacks) {
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
  char *kept_name = flex_take(&arena, name_size);
  memcpy(kept_name, name, name_size);
  instance->name = kept_name;
  instance->callbacks = *callbacks;
  instance->backend = flex_backend_create(block + arena.used);
  instance->session.kind = kind;
  flex_enter_phase(instance, INSTANTIATED);
  return instance;
}

// why an instance cannot be made; NULL if it can
static const char *obstacle(fmi2String name, fmi2Type type, fmi2String guid, const fmi2CallbackFunctions *functions) {
  if (!functions) return "fmi2Instantiate needs callback functions, got none";
  if (!name || !*name) return "fmi2Instantiate needs an instance name, got an empty one";
  if (type != fmi2CoSimulation && type != fmi2ModelExchange) return "fmi2Instantiate got a type that FMI 2.0 doesn't have";
  if (type == fmi2ModelExchange && !flex_backend_has_model_exchange())
    return "this FMU supports co-simulation only, not model exchange";
  if (!guid || strcmp(guid, flex_backend_guid()) != 0)
    return "the GUID differs from that of the binary; modelDescription.xml and binary do not belong together";
  return NULL;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn) {
  (void)fmuResourceLocation;
  (void)visible;
  const char *why_not = obstacle(instanceName, fmuType, fmuGUID, functions);
  flex_kind kind = fmuType == fmi2ModelExchange ? EXCHANGE : STEPPING;
  flex_instance *instance = why_not ? NULL : create(instanceName, kind, functions);
  if (!why_not && !instance) why_not = "out of memory";
  if (why_not) {
    if (functions && functions->logger)
      functions->logger(functions->componentEnvironment, instanceName ? instanceName : "", fmi2Error,
                        flex_log_categories[LOG_ERROR], why_not);
    return NULL;
  }

  // what went wrong is always said; the rest on request
  for (int i = 0; i < N_LOG_CATEGORIES; i++) instance->logged[i] = loggingOn || i != LOG_STATISTICS;
  return instance;
}

void fmi2FreeInstance(fmi2Component c) {
  if (!c) return;
  flex_release_states(c);
  const fmi2CallbackFunctions callbacks = ((flex_instance *)c)->callbacks;
  flex_release(&callbacks, c);
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

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
  flex_instance *instance = flex_checked(c, call_fmi2SetupExperiment);
  if (!instance) return fmi2Error;

  if (toleranceDefined && !(tolerance > 0.0 && tolerance < 1.0))
    return flex_log(instance, fmi2Error, LOG_ERROR, "the relative tolerance must be between 0 and 1, got %g", tolerance);
  if (!isfinite(startTime))
    return flex_log(instance, fmi2Error, LOG_ERROR, "the start time must be finite, got %g s", startTime);
  if (stopTimeDefined && !(stopTime > startTime))
    return flex_log(instance, fmi2Error, LOG_ERROR, "the stop time must be after the start time %g s, got %g s", startTime,
                    stopTime);

  flex_backend_set_start_time(instance->backend, startTime);
  instance->session.has_stop_time = stopTimeDefined != 0;
  instance->session.stop_time = stopTimeDefined ? stopTime : 0.0;
  if (!toleranceDefined) return fmi2OK;
  double used = flex_backend_set_tolerance(instance->backend, tolerance);
  if (used == tolerance) return fmi2OK;
  return flex_log(instance, fmi2Warning, LOG_WARNING, "the relative tolerance %g is beyond double precision, %g is used",
                  tolerance, used);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2EnterInitializationMode);
  if (!instance) return fmi2Error;
  flex_enter_phase(instance, INITIALISATION_MODE);
  return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2ExitInitializationMode);
  if (!instance) return fmi2Error;
  if (flex_backend_begin(instance->backend)) return flex_log_refusal(instance);
  flex_enter_phase(instance, instance->session.kind == EXCHANGE ? EVENT_MODE : STEP_COMPLETE);
  return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2Terminate);
  if (!instance) return fmi2Error;
  char text[FLEX_MESSAGE_SIZE];
  flex_backend_summarise(instance->backend, text, sizeof text);
  flex_log(instance, fmi2OK, LOG_STATISTICS, "%s", text);
  flex_enter_phase(instance, TERMINATED);
  return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2Reset);
  if (!instance) return fmi2Error;
  flex_backend_reset(instance->backend);
  const int kind = instance->session.kind;
  memset(&instance->session, 0, sizeof instance->session);
  instance->session.kind = kind;
  instance->reason[0] = '\0';
  flex_enter_phase(instance, INSTANTIATED);
  return fmi2OK;
}

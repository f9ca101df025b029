/* Creation and end of an instance. */
#include <string.h>

#include "instance.h"

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
  if (type != fmi2CoSimulation && type != fmi2ModelExchange) return "fmi2Instantiate got a type that FMI 2.0 doesn't have";
  return flex_obstacle(name, type == fmi2ModelExchange ? EXCHANGE : STEPPING, guid);
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
    const char *name = instanceName ? instanceName : "";
    if (functions) flex_hand_over(functions, name, fmi2Error, flex_log_categories[LOG_ERROR], why_not);
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

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
  flex_instance *instance = flex_checked(c, call_fmi2SetupExperiment);
  return instance ? flex_set_up(instance, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime) : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  flex_instance *instance = flex_checked(c, call_fmi2EnterInitializationMode);
  if (!instance) return fmi2Error;
  flex_enter_phase(instance, INITIALISATION_MODE);
  return fmi2OK;
}

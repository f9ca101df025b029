/* Creation, modes and end of an instance. */
#include <math.h>
#include <string.h>

#include "fmi3_instance.h"

const char *fmi3GetVersion(void) {
  return fmi3Version;
}

// instance and backend in one block of memory; what its sizes follow from in others
static flex_instance *create(void) {
  flex_arena measure = {NULL, 0};
  flex_take(&measure, sizeof(flex_instance));
  char *block = calloc(1, measure.used + flex_backend_size());
  if (!block) return NULL;
  flex_instance *instance = (flex_instance *)(void *)block;
  instance->backend = flex_backend_create(block + measure.used);
  instance->before = malloc(instance->backend->state_size);
  instance->scratch = calloc(instance->backend->n_outputs + flex_backend_indicators() + 1, sizeof(double));
  if (instance->before && instance->scratch) return instance;
  fmi3FreeInstance(instance);
  return NULL;
}

// why an instance cannot be made; NULL if it can
static const char *obstacle(fmi3String name, flex_kind kind, fmi3String token) {
  if (!name || !*name) return "an instance needs a name, got an empty one";
  if (kind == EXCHANGE && !flex_backend_has_model_exchange())
    return "this FMU supports co-simulation only, not model exchange";
  if (!token || strcmp(token, flex_backend_guid()) != 0)
    return "the instantiation token differs from that of the binary; modelDescription.xml and binary do not belong together";
  return NULL;
}

static fmi3Instance instantiate(fmi3String name, flex_kind kind, fmi3String token, int logging, int has_events,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger) {
  const char *why_not = obstacle(name, kind, token);
  if (!why_not && has_events && !flex_backend_has_model_exchange()) why_not = "this FMU has no event mode (hasEventMode = false)";
  flex_instance *instance = why_not ? NULL : create();
  if (!why_not && !instance) why_not = "out of memory";
  if (why_not) {
    if (logger) logger(environment, fmi3Error, flex_log_categories[LOG_ERROR], why_not);
    return NULL;
  }
  instance->session.kind = kind;
  instance->session.has_events = has_events;
  instance->environment = environment;
  instance->logger = logger;
  for (int i = 0; i < N_LOG_CATEGORIES; i++) instance->logged[i] = logging;
  flex_enter_phase(instance, INSTANTIATED);
  return instance;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                          fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage) {
  (void)resourcePath, (void)visible;
  return instantiate(instanceName, EXCHANGE, instantiationToken, loggingOn, 0, instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                         fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
                                         fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate) {
  (void)resourcePath, (void)visible, (void)earlyReturnAllowed;
  (void)requiredIntermediateVariables, (void)nRequiredIntermediateVariables, (void)intermediateUpdate;
  return instantiate(instanceName, STEPPING, instantiationToken, loggingOn, eventModeUsed, instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption) {
  (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn, (void)clockUpdate;
  (void)lockPreemption, (void)unlockPreemption;
  if (logMessage)
    logMessage(instanceEnvironment, fmi3Error, flex_log_categories[LOG_ERROR], "this FMU does not support scheduled execution");
  return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) {
  flex_instance *ours = instance;
  if (!ours) return;
  flex_release_states(ours);
  free(ours->before);
  free(ours->scratch);
  free(ours);
}

static int category_index(const char *name) {
  for (int i = 0; i < N_LOG_CATEGORIES; i++)
    if (name && strcmp(name, flex_log_categories[i]) == 0) return i;
  return -1;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
  flex_instance *ours = flex_checked(instance, call_fmi3SetDebugLogging);
  if (!ours || flex_lacks(ours, call_fmi3SetDebugLogging, "log categories", categories, nCategories)) return fmi3Error;
  for (size_t i = 0; i < nCategories; i++)
    if (category_index(categories[i]) < 0)
      return flex_log(ours, fmi3Error, LOG_ERROR, "log category '%s' is unknown; modelDescription.xml lists them",
                      categories[i] ? categories[i] : "");
  for (int i = 0; nCategories == 0 && i < N_LOG_CATEGORIES; i++) ours->logged[i] = loggingOn;
  for (size_t i = 0; i < nCategories; i++) ours->logged[category_index(categories[i])] = loggingOn;
  return fmi3OK;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterInitializationMode);
  if (!ours) return fmi3Error;
  if (toleranceDefined && !(tolerance > 0.0 && tolerance < 1.0))
    return flex_log(ours, fmi3Error, LOG_ERROR, "the relative tolerance must be between 0 and 1, got %g", tolerance);
  if (!isfinite(startTime))
    return flex_log(ours, fmi3Error, LOG_ERROR, "the start time must be finite, got %g s", startTime);
  if (stopTimeDefined && !(stopTime > startTime))
    return flex_log(ours, fmi3Error, LOG_ERROR, "the stop time must be after the start time %g s, got %g s", startTime, stopTime);

  flex_backend_set_start_time(ours->backend, startTime);
  ours->session.has_stop_time = stopTimeDefined;
  ours->session.stop_time = stopTimeDefined ? stopTime : 0.0;
  flex_enter_phase(ours, INITIALISATION_MODE);
  if (!toleranceDefined) return fmi3OK;
  double used = flex_backend_set_tolerance(ours->backend, tolerance);
  if (used == tolerance) return fmi3OK;
  return flex_log(ours, fmi3Warning, LOG_WARNING, "the relative tolerance %g is beyond double precision, %g is used", tolerance,
                  used);
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3ExitInitializationMode);
  if (!ours) return fmi3Error;
  if (flex_backend_begin(ours->backend)) return flex_log_refusal(ours);
  flex_enter_phase(ours, ours->session.kind == EXCHANGE || ours->session.has_events ? EVENT_MODE : STEP_MODE);
  return fmi3OK;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterEventMode);
  if (!ours) return fmi3Error;
  if (ours->session.kind == STEPPING && !ours->session.has_events)
    return flex_log(ours, fmi3Error, LOG_ERROR, "this instance was made without event mode (eventModeUsed = false)");
  flex_enter_phase(ours, EVENT_MODE);
  return fmi3OK;
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterStepMode);
  if (ours) flex_enter_phase(ours, STEP_MODE);
  return ours ? fmi3OK : fmi3Error;
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3Terminate);
  if (!ours) return fmi3Error;
  char text[FLEX_MESSAGE_SIZE];
  flex_backend_summarise(ours->backend, text, sizeof text);
  flex_log(ours, fmi3OK, LOG_STATISTICS, "%s", text);
  flex_enter_phase(ours, TERMINATED);
  return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3Reset);
  if (!ours) return fmi3Error;
  flex_backend_reset(ours->backend);
  ours->session.has_stop_time = 0;
  ours->session.stop_time = 0.0;
  flex_enter_phase(ours, INSTANTIATED);
  return fmi3OK;
}

/* Creation and end of an instance, and its modes beyond those of FMI 2.0. */
#include <string.h>

#include "instance.h"

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
  size_t asked = FLEX_ASKED * (size_t)instance->backend->n_inputs;
  instance->scratch = calloc(instance->backend->n_outputs + flex_backend_indicators() + asked + 1, sizeof(double));
  if (instance->before && instance->scratch) return instance;
  fmi3FreeInstance(instance);
  return NULL;
}

static fmi3Instance instantiate(fmi3String name, flex_kind kind, fmi3String token, int logging, int has_events,
                                int returns_early, flex_callbacks callbacks) {
  const char *why_not = flex_obstacle(name, kind, token);
  flex_instance *instance = why_not ? NULL : create();
  if (!why_not && !instance) why_not = "out of memory";
  if (why_not) {
    flex_hand_over(&callbacks, name, fmi3Error, flex_log_categories[LOG_ERROR], why_not);
    return NULL;
  }
  instance->session.kind = kind;
  instance->session.has_events = has_events;
  instance->session.returns_early = returns_early;
  instance->callbacks = callbacks;
  for (int i = 0; i < N_LOG_CATEGORIES; i++) instance->logged[i] = logging;
  flex_enter_phase(instance, INSTANTIATED);
  return instance;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                          fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage) {
  (void)resourcePath, (void)visible;
  const flex_callbacks callbacks = {instanceEnvironment, logMessage, NULL, 0, 0};
  return instantiate(instanceName, EXCHANGE, instantiationToken, loggingOn, 0, 0, callbacks);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
                                         fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
                                         fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate) {
  (void)resourcePath, (void)visible;
  flex_callbacks callbacks = {instanceEnvironment, logMessage, NULL, 0, 0};
  flex_instance *ours = instantiate(instanceName, STEPPING, instantiationToken, loggingOn, eventModeUsed, earlyReturnAllowed, callbacks);
  if (!ours || !requiredIntermediateVariables || !flex_backend_has_model_exchange()) return ours;
  ours->callbacks.update = nRequiredIntermediateVariables ? intermediateUpdate : NULL;
  for (size_t i = 0; i < nRequiredIntermediateVariables; i++) {
    int is_input = requiredIntermediateVariables[i] < ours->backend->n_inputs;
    *(is_input ? &ours->callbacks.sets_inputs : &ours->callbacks.reads) = 1;
  }
  return ours;
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

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterStepMode);
  if (ours) flex_enter_phase(ours, STEP_MODE);
  return ours ? fmi3OK : fmi3Error;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterInitializationMode);
  if (!ours) return fmi3Error;
  fmi3Status status = flex_set_up(ours, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime);
  if (status < fmi3Error) flex_enter_phase(ours, INITIALISATION_MODE);
  return status;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterEventMode);
  if (!ours) return fmi3Error;
  if (ours->session.kind == STEPPING && !ours->session.has_events)
    return flex_log(ours, fmi3Error, LOG_ERROR, "this instance was made without event mode (eventModeUsed = false)");
  flex_enter_phase(ours, EVENT_MODE);
  return fmi3OK;
}

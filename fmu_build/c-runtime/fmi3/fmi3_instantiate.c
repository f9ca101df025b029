/* Creation of an instance, and its modes beyond those of FMI 2.0. */
#include "instance.h"

const char *fmi3GetVersion(void) {
  return fmi3Version;
}

static flex_instance *instantiate(fmi3String name, flex_kind kind, fmi3String token, int logging, int has_events,
                                  int returns_early, flex_callbacks callbacks) {
  flex_instance *instance = flex_instantiate(name, kind, token, logging, &callbacks);
  if (!instance) return NULL;
  const flex_backend *backend = instance->backend;
  const size_t numbers = backend->n_outputs + flex_backend_indicators() + FLEX_ASKED * (size_t)backend->n_inputs + 1;
  instance->scratch = calloc(1, numbers * sizeof(double) + backend->state_size);
  if (!instance->scratch) {
    flex_log(instance, fmi3Error, LOG_ERROR, "out of memory");
    fmi3FreeInstance(instance);
    return NULL;
  }
  instance->before = instance->scratch + numbers;
  instance->session.has_events = has_events;
  instance->session.returns_early = returns_early;
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

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
  return flex_enter_phase(instance, call_fmi3EnterStepMode, STEP_MODE);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterInitializationMode);
  if (!ours) return fmi3Error;
  fmi3Status status = flex_set_up(ours, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime);
  if (status < fmi3Error) ours->session.phase = INITIALISATION_MODE;
  return status;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
  flex_instance *ours = flex_checked(instance, call_fmi3EnterEventMode);
  if (!ours) return fmi3Error;
  if (ours->session.kind == STEPPING && !ours->session.has_events)
    return flex_log(ours, fmi3Error, LOG_ERROR, "this instance was made without event mode (eventModeUsed = false)");
  ours->session.phase = EVENT_MODE;
  return fmi3OK;
}

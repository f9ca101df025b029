/* Creation of an instance. */
#include "instance.h"

const char *fmi2GetTypesPlatform(void) {
  return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void) {
  return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID, fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean loggingOn) {
  (void)fmuResourceLocation, (void)visible;
  if (!functions) return NULL;
  if (fmuType == fmi2CoSimulation || fmuType == fmi2ModelExchange)
    return flex_instantiate(instanceName, fmuType == fmi2ModelExchange ? EXCHANGE : STEPPING, fmuGUID, loggingOn, functions);
  flex_hand_over(functions, instanceName ? instanceName : "", fmi2Error, flex_log_categories[LOG_ERROR],
                 "fmi2Instantiate got a type that FMI 2.0 doesn't have");
  return NULL;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
  flex_instance *instance = flex_checked(c, call_fmi2SetupExperiment);
  return instance ? flex_set_up(instance, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime) : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  return flex_enter_phase(c, call_fmi2EnterInitializationMode, INITIALISATION_MODE);
}

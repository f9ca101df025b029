/* An FMU that does nothing: every call succeeds, every variable is zero. Callers find the functions by name alone, and the
 * calling conventions of C let a function leave arguments unread, so most of them take none. */
#include <stddef.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))
#define SUCCEEDS(name) \
  EXPORT int name(void) { return 0; }

EXPORT const char *fmi2GetTypesPlatform(void) {
  return "default";
}

EXPORT const char *fmi2GetVersion(void) {
  return "2.0";
}

EXPORT const void *fmi2Instantiate(void) {
  static const char instance = 0;
  return &instance;
}

EXPORT int fmi2GetReal(const void *instance, const unsigned *references, size_t count, double *values) {
  (void)instance, (void)references;
  memset(values, 0, count * sizeof *values);
  return 0;
}

EXPORT int fmi2GetInteger(const void *instance, const unsigned *references, size_t count, int *values) {
  (void)instance, (void)references;
  memset(values, 0, count * sizeof *values);
  return 0;
}

EXPORT int fmi2GetRealOutputDerivatives(const void *instance, const unsigned *references, size_t count, const int *orders,
                                        double *values) {
  (void)instance, (void)references, (void)orders;
  memset(values, 0, count * sizeof *values);
  return 0;
}

SUCCEEDS(fmi2FreeInstance)
SUCCEEDS(fmi2SetDebugLogging)
SUCCEEDS(fmi2SetupExperiment)
SUCCEEDS(fmi2EnterInitializationMode)
SUCCEEDS(fmi2ExitInitializationMode)
SUCCEEDS(fmi2Terminate)
SUCCEEDS(fmi2Reset)
SUCCEEDS(fmi2GetBoolean)
SUCCEEDS(fmi2GetString)
SUCCEEDS(fmi2SetReal)
SUCCEEDS(fmi2SetInteger)
SUCCEEDS(fmi2SetBoolean)
SUCCEEDS(fmi2SetString)
SUCCEEDS(fmi2GetFMUstate)
SUCCEEDS(fmi2SetFMUstate)
SUCCEEDS(fmi2FreeFMUstate)
SUCCEEDS(fmi2SerializedFMUstateSize)
SUCCEEDS(fmi2SerializeFMUstate)
SUCCEEDS(fmi2DeSerializeFMUstate)
SUCCEEDS(fmi2GetDirectionalDerivative)
SUCCEEDS(fmi2SetRealInputDerivatives)
SUCCEEDS(fmi2DoStep)
SUCCEEDS(fmi2CancelStep)
SUCCEEDS(fmi2GetStatus)
SUCCEEDS(fmi2GetRealStatus)
SUCCEEDS(fmi2GetIntegerStatus)
SUCCEEDS(fmi2GetBooleanStatus)
SUCCEEDS(fmi2GetStringStatus)

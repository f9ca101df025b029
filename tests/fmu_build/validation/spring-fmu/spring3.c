/* The same FMU by the functions of FMI 3.0: value references of Integers count from 20, of Booleans from 30, of Strings from 40. */
#include "spring.c"

#include "fmi3Functions.h"

static fmi3LogMessageCallback log_message;

static void log_by_fmi3(void *environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String message, ...) {
  log_message(environment, (fmi3Status)status, category, message);
}

static fmi3Instance made_by_fmi3(fmi2Type type, fmi3String name, fmi3String token, fmi3String path, fmi3LogMessageCallback log) {
  static fmi2CallbackFunctions callbacks = {log_by_fmi3, calloc, free, NULL, NULL};
  log_message = log;
  return fmi2Instantiate(name, type, token, path, &callbacks, 0, 0);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
  return made_by_fmi3(fmi2CoSimulation, name, token, path, log);
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
  return made_by_fmi3(fmi2ModelExchange, name, token, path, log);
}
void fmi3FreeInstance(fmi3Instance c) { fmi2FreeInstance(c); }
const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 from,
                                       fmi3Boolean ends, fmi3Float64 to) {
  fmi2Status status = fmi2SetupExperiment(c, has_tolerance, tolerance, from, ends, to);
  return (fmi3Status)(status ? status : fmi2EnterInitializationMode(c));
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 h, fmi3Boolean no_set_state, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
  fmi2Status status = fmi2DoStep(c, time, h, no_set_state);
  *event = *early = false;
  *terminate = status == fmi2Discard && ((Spring *)c)->discarded;
  fmi2GetRealStatus(c, fmi2LastSuccessfulTime, last);
  return (fmi3Status)(*terminate ? fmi2OK : status);
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *time) {
  fmi2EventInfo info;
  fmi2Status status = fmi2NewDiscreteStates(c, &info);
  *again = *terminate = *nominals = *values = false;
  if (status == fmi2OK) *defined = info.nextEventTimeDefined, *time = info.nextEventTime;
  return (fmi3Status)status;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean no_set_state, fmi3Boolean *event, fmi3Boolean *terminate) {
  fmi2Boolean enter, end;
  fmi2Status status = fmi2CompletedIntegratorStep(c, no_set_state, &enter, &end);
  *event = enter, *terminate = end;
  return (fmi3Status)status;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { return *n = 1, fmi3OK; }
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { return *n = 2, fmi3OK; }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { return fmi3OK; }

#define ACCESS(type, of_fmi2, base, kind)                                                                                     \
  fmi3Status fmi3Get##type(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3##kind value[], size_t values) {       \
    fmi2Status status = fmi2OK;                                                                                               \
    for (size_t i = 0; i < n && !status; i++) {                                                                               \
      fmi2ValueReference reference = r[i] - base;                                                                             \
      fmi2##of_fmi2 got;                                                                                                      \
      if (!(status = fmi2Get##of_fmi2(c, &reference, 1, &got))) value[i] = (fmi3##kind)got;                                   \
    }                                                                                                                         \
    return (fmi3Status)status;                                                                                                \
  }                                                                                                                           \
  fmi3Status fmi3Set##type(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3##kind value[], size_t values) { \
    fmi2Status status = fmi2OK;                                                                                               \
    for (size_t i = 0; i < n && !status; i++) {                                                                               \
      fmi2ValueReference reference = r[i] - base;                                                                             \
      fmi2##of_fmi2 given = (fmi2##of_fmi2)value[i];                                                                          \
      status = fmi2Set##of_fmi2(c, &reference, 1, &given);                                                                    \
    }                                                                                                                         \
    return (fmi3Status)status;                                                                                                \
  }
ACCESS(Int64, Integer, 20, Int64)
ACCESS(Int32, Integer, 20, Int32)
ACCESS(Boolean, Boolean, 30, Boolean)
ACCESS(String, String, 40, String)

#define SAME(name, of_fmi2, parameters, ...) \
  fmi3Status fmi3##name parameters { return (fmi3Status)fmi2##of_fmi2(__VA_ARGS__); }
#define PLAIN(name) SAME(name, name, (fmi3Instance c), c)
#define VECTOR(name, of_fmi2) SAME(name, of_fmi2, (fmi3Instance c, fmi3Float64 x[], size_t n), c, x, n)
PLAIN(ExitInitializationMode) PLAIN(EnterEventMode) PLAIN(EnterContinuousTimeMode) PLAIN(Terminate) PLAIN(Reset)
VECTOR(GetContinuousStates, GetContinuousStates) VECTOR(GetContinuousStateDerivatives, GetDerivatives)
VECTOR(GetNominalsOfContinuousStates, GetNominalsOfContinuousStates) VECTOR(GetEventIndicators, GetEventIndicators)
SAME(SetContinuousStates, SetContinuousStates, (fmi3Instance c, const fmi3Float64 x[], size_t n), c, x, n)
SAME(GetFloat64, GetReal, (fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 x[], size_t nx), c, r, n, x)
SAME(SetFloat64, SetReal, (fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 x[], size_t nx), c, r, n, x)
SAME(SetTime, SetTime, (fmi3Instance c, fmi3Float64 time), c, time)
SAME(SetDebugLogging, SetDebugLogging, (fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]), c, on, n, categories)
SAME(GetFMUState, GetFMUstate, (fmi3Instance c, fmi3FMUState *state), c, state)
SAME(SetFMUState, SetFMUstate, (fmi3Instance c, fmi3FMUState state), c, state)
SAME(FreeFMUState, FreeFMUstate, (fmi3Instance c, fmi3FMUState *state), c, state)
SAME(SerializedFMUStateSize, SerializedFMUstateSize, (fmi3Instance c, fmi3FMUState state, size_t *n), c, state, n)
SAME(SerializeFMUState, SerializeFMUstate, (fmi3Instance c, fmi3FMUState state, fmi3Byte data[], size_t n), c, state, (char *)data, n)
SAME(DeserializeFMUState, DeSerializeFMUstate, (fmi3Instance c, const fmi3Byte data[], size_t n, fmi3FMUState *state), c,
     (const char *)data, n, state)
SAME(GetDirectionalDerivative, GetDirectionalDerivative,
     (fmi3Instance c, const fmi3ValueReference u[], size_t nu, const fmi3ValueReference k[], size_t nk, const fmi3Float64 seed[],
      size_t ns, fmi3Float64 value[], size_t nv),
     c, u, nu, k, nk, seed, value)
SAME(GetOutputDerivatives, GetRealOutputDerivatives,
     (fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int32 order[], fmi3Float64 value[], size_t nv), c, r, n, order,
     value)

/* what has nothing to do here */
#pragma GCC diagnostic ignored "-Wattribute-alias"
fmi3Status fmi3Nothing(void) { return fmi3Error; }
#define NONE(name) fmi3##name##TYPE fmi3##name __attribute__((alias("fmi3Nothing")));
NONE(InstantiateScheduledExecution) NONE(GetFloat32) NONE(GetInt8) NONE(GetUInt8) NONE(GetInt16) NONE(GetUInt16) NONE(GetUInt32)
NONE(GetUInt64) NONE(GetBinary) NONE(GetClock) NONE(SetFloat32) NONE(SetInt8) NONE(SetUInt8) NONE(SetInt16) NONE(SetUInt16)
NONE(SetUInt32) NONE(SetUInt64) NONE(SetBinary) NONE(SetClock) NONE(GetNumberOfVariableDependencies) NONE(GetVariableDependencies)
NONE(GetAdjointDerivative) NONE(EnterConfigurationMode) NONE(ExitConfigurationMode) NONE(GetIntervalDecimal) NONE(GetIntervalFraction)
NONE(GetShiftDecimal) NONE(GetShiftFraction) NONE(SetIntervalDecimal) NONE(SetIntervalFraction) NONE(SetShiftDecimal)
NONE(SetShiftFraction) NONE(EvaluateDiscreteStates) NONE(ActivateModelPartition)

/* An FMU 2.0 for co-simulation around one for model exchange, whose library lies beside this one: our solver makes its
 * steps, everything else is passed on. Inputs that are set between two steps are an event, at which discrete states are updated. */
#define _GNU_SOURCE
#include "exchange.h"
#include "fmi2FunctionTypes.h"
#include "wrap_model.h" /* INNER, N, M, ...: of the FMU inside */

#include <dlfcn.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_ROUNDS = 1000 };
/* functions of the FMU inside */
#define FUNCTIONS(F)                                                                                                     \
  F(Instantiate) F(FreeInstance) F(SetDebugLogging) F(SetupExperiment) F(EnterInitializationMode)                        \
  F(ExitInitializationMode) F(Terminate) F(Reset) F(GetReal) F(GetInteger) F(GetBoolean) F(GetString) F(SetReal)         \
  F(SetInteger) F(SetBoolean) F(SetString) F(GetDirectionalDerivative) F(EnterEventMode) F(NewDiscreteStates)            \
  F(EnterContinuousTimeMode) F(CompletedIntegratorStep) F(SetTime) F(SetContinuousStates) F(GetDerivatives)              \
  F(GetEventIndicators) F(GetContinuousStates) F(GetNominalsOfContinuousStates)

typedef struct {
#define MEMBER(name) fmi2##name##TYPE *name;
  FUNCTIONS(MEMBER)
  void *library;
  fmi2Component component;
  const fmi2CallbackFunctions *callbacks;
  enum { STARTING, EVENT, STEPPING } mode;
  int begun, ended;                    /* whether the integration has begun, and the FMU has ended the simulation */
  double start, next;                  /* of the run, and the next time event [s] */
  flex_exchange exchange;
} wrapper;

static int load(wrapper *w) {
  Dl_info own;
  char path[4096];
  if (dladdr(unknown, &own) == 0) return 0; /* the table is in this library */
  const char *slash = strrchr(own.dli_fname, '/');
  snprintf(path, sizeof path, "%.*s%s", slash == NULL ? 0 : (int)(slash - own.dli_fname) + 1, own.dli_fname, INNER);
  if ((w->library = dlopen(path, RTLD_NOW | RTLD_LOCAL)) == NULL) return 0;
#define LOAD(name) *(void **)&w->name = dlsym(w->library, "fmi2" #name);
  FUNCTIONS(LOAD)
  return w->Instantiate != NULL && w->NewDiscreteStates != NULL && w->GetContinuousStates != NULL;
}

static fmi2Status say(wrapper *w, fmi2Status status, const char *reason) {
  w->callbacks->logger(w->callbacks->componentEnvironment, INNER, status, "logStatusError", "it stopped at %g s: %s",
                       w->exchange.time, reason);
  return status;
}

FLEX_EXPORTED void fmi2FreeInstance(fmi2Component c) {
  wrapper *w = c;
  if (w == NULL) return;
  if (w->component != NULL) w->FreeInstance(w->component);
  if (w->library != NULL) dlclose(w->library);
  free(w->exchange.memory), free(w);
}

FLEX_EXPORTED fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  wrapper *w = calloc(1, sizeof *w);
  if (w == NULL) return NULL;
  w->callbacks = callbacks;
  flex_exchange *e = &w->exchange;
  e->memory = calloc(1, flex_exchange_size(N, M));
  int is_ready = type == fmi2CoSimulation && e->memory != NULL && load(w);
  if (is_ready) w->component = w->Instantiate(name, fmi2ModelExchange, guid, resources, callbacks, visible, logging);
  if (w->component == NULL) {
    say(w, fmi2Error, is_ready ? "the FMU for model exchange refuses to be instantiated" : "it can't be loaded for co-simulation");
    fmi2FreeInstance(w);
    return NULL;
  }
  e->component = &w->component, e->set_time = (int (*)(void *, double))w->SetTime;
  e->set_states = (int (*)(void *, const double *, size_t))w->SetContinuousStates;
  e->get_states = (int (*)(void *, double *, size_t))w->GetContinuousStates;
  e->get_nominals = (int (*)(void *, double *, size_t))w->GetNominalsOfContinuousStates;
  e->get_rates = (int (*)(void *, double *, size_t))w->GetDerivatives;
  e->get_indicators = (int (*)(void *, double *, size_t))w->GetEventIndicators;
  e->set_real = (void (*)(void))w->SetReal;
  e->completed = NEEDS_COMPLETED ? (void (*)(void))w->CompletedIntegratorStep : NULL;
  e->directional = HAS_DIRECTIONAL ? (void (*)(void))w->GetDirectionalDerivative : NULL;
  e->unknown = unknown, e->known = known, e->references = N, e->n = N, e->m = M, e->tolerance = TOLERANCE;
  return w;
}

static fmi2Status stopped(wrapper *w, int outcome) {
  w->ended = outcome == EXCHANGE_ENDS;
  if (outcome == EXCHANGE_FAILED) return (fmi2Status)w->exchange.status;
  return w->ended ? fmi2Discard : say(w, fmi2Discard, "its equations have no solution there");
}

/* updates discrete states until none changes any more, then goes on with steps; after a jump of inputs alone with step and Jacobian */
static fmi2Status leave_event(wrapper *w, int inputs_alone) {
  fmi2EventInfo info = {0};
  int anew = !w->begun || !inputs_alone, round = 0;
  fmi2Status status;
  do {
    if (++round > MOST_ROUNDS) return say(w, fmi2Error, "its events don't end");
    if ((status = w->NewDiscreteStates(w->component, &info)) > fmi2Warning) return status;
    anew = anew || info.valuesOfContinuousStatesChanged || info.nominalsOfContinuousStatesChanged;
    if (info.terminateSimulation) return stopped(w, EXCHANGE_ENDS);
  } while (info.newDiscreteStatesNeeded);
  w->next = info.nextEventTimeDefined ? info.nextEventTime : INFINITY;
  if ((status = w->EnterContinuousTimeMode(w->component)) > fmi2Warning) return status;
  w->mode = STEPPING, w->begun = 1;
  int outcome = flex_exchange_begin(&w->exchange, anew);
  return outcome == EXCHANGE_REACHED ? fmi2OK : stopped(w, outcome);
}

static fmi2Status enter_event(wrapper *w) {
  if (w->mode != STEPPING) return fmi2OK;
  return w->mode = EVENT, w->EnterEventMode(w->component);
}

FLEX_EXPORTED fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_rollback) {
  wrapper *w = c;
  flex_exchange *e = &w->exchange;
  double end = time + step, near = 1e-9 * step + 4.0 * DBL_EPSILON * fabs(end);
  fmi2Status status;
  if (w->mode == EVENT && (status = leave_event(w, 1)) > fmi2Warning) return status;
  if (e->time < time) e->time = time;
  e->no_rollback = no_rollback;
  for (int idle = 0; idle < MOST_ROUNDS;) {
    double begin = e->time;
    int outcome = flex_exchange_advance(e, w->next < end - near ? w->next : end);
    if (outcome != EXCHANGE_REACHED && outcome != EXCHANGE_EVENT) return stopped(w, outcome);
    /* state events and step events, then time events at their very instants */
    if (outcome == EXCHANGE_EVENT || e->time >= w->next - near) {
      if (e->time < w->next && w->next <= e->time + near) w->SetTime(w->component, e->time = w->next);
      if ((status = enter_event(w)) > fmi2Warning || (status = leave_event(w, 0)) > fmi2Warning) return status;
      idle = e->time > begin + 1e-13 * step ? 0 : idle + 1;
    } else if (e->time >= end) {
      return fmi2OK;
    }
  }
  return say(w, fmi2Error, "it has events without end");
}

FLEX_EXPORTED fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real start,
                                           fmi2Boolean stops, fmi2Real stop) {
  wrapper *w = c;
  w->start = start;
  if (defined) w->exchange.tolerance = tolerance < 1e-12 ? 1e-12 : tolerance;
  return w->SetupExperiment(w->component, defined, tolerance, start, stops, stop);
}

FLEX_EXPORTED fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  wrapper *w = c;
  fmi2Status status = w->ExitInitializationMode(w->component);
  w->exchange.plant = NULL, w->exchange.time = w->start, w->mode = EVENT;
  return status > fmi2Warning ? status : leave_event(w, 0);
}

FLEX_EXPORTED fmi2Status fmi2Reset(fmi2Component c) {
  wrapper *w = c;
  w->mode = STARTING, w->begun = w->ended = 0;
  return w->Reset(w->component);
}

/* what is passed on, and what there isn't: importers look for all functions */
#define PASS(name, parameters, ...) \
  FLEX_EXPORTED fmi2Status fmi2##name parameters { return ((wrapper *)c)->name(((wrapper *)c)->component, __VA_ARGS__); }
#define TRANSFER(type)                                                                                                    \
  PASS(Get##type, (fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2##type v[]), r, n, v)                     \
  FLEX_EXPORTED fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2##type v[]) {      \
    fmi2Status status = enter_event(c);                                                                                   \
    return status > fmi2Warning ? status : ((wrapper *)c)->Set##type(((wrapper *)c)->component, r, n, v);                 \
  }
TRANSFER(Real) TRANSFER(Integer) TRANSFER(Boolean) TRANSFER(String)
PASS(SetDebugLogging, (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]), on, n, names)
#define CALL(name) FLEX_EXPORTED fmi2Status fmi2##name(fmi2Component c) { return ((wrapper *)c)->name(((wrapper *)c)->component); }
CALL(EnterInitializationMode) CALL(Terminate)
FLEX_EXPORTED const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
FLEX_EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }
#define REFUSE(name) FLEX_EXPORTED fmi2Status fmi2##name(void) { return fmi2Error; }
REFUSE(GetFMUstate) REFUSE(SetFMUstate) REFUSE(FreeFMUstate) REFUSE(SerializedFMUstateSize) REFUSE(SerializeFMUstate)
REFUSE(DeSerializeFMUstate) REFUSE(GetDirectionalDerivative) REFUSE(SetRealInputDerivatives) REFUSE(GetRealOutputDerivatives)
REFUSE(CancelStep) REFUSE(GetStatus) REFUSE(GetIntegerStatus) REFUSE(GetStringStatus)

#define STATUS(type, known, of)                                                                                           \
  FLEX_EXPORTED fmi2Status fmi2Get##type##Status(fmi2Component c, const fmi2StatusKind kind, fmi2##type *value) {              \
    *value = ((wrapper *)c)->of;                                                                                          \
    return kind == known ? fmi2OK : fmi2Discard;                                                                          \
  }
STATUS(Real, fmi2LastSuccessfulTime, exchange.time)
STATUS(Boolean, fmi2Terminated, ended)

/* A mass on a spring that an input pulls: a sound FMU 2.0 for both interfaces, written apart from the package's runtime.
   Each macro BREAK_... spoils it in one respect, so that validation has something to find. */
#include "fmi2Functions.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define GUID "{spring}"
#define STIFFNESS 40.0
#define DAMPING 0.5
#define LARGEST_STEP 1e-3

enum { PULL, POSITION, VELOCITY, POSITION_RATE, VELOCITY_RATE, FORCE, VARIABLES };

typedef struct {
  double time, x[2], u, u_rate;
} State;

typedef struct {
  State now;
  fmi2CallbackFunctions callbacks;
  char *scratch;
} Spring;

#ifdef BREAK_INSTANCES
static State shared;
#define NOW(s) ((void)(s), &shared)
#else
#define NOW(s) (&(s)->now)
#endif

static void rates(const double *x, double u, double *dx) {
  dx[0] = x[1];
  dx[1] = STIFFNESS * (u - x[0]) - DAMPING * x[1];
}

/* one step of the classical Runge-Kutta method */
static void runge_kutta(State *s, double h) {
  double k[4][2], y[2];
  static const double at[4] = {0.0, 0.5, 0.5, 1.0};
  for (int stage = 0; stage < 4; stage++) {
    for (int i = 0; i < 2; i++) y[i] = s->x[i] + (stage ? at[stage] * h * k[stage - 1][i] : 0.0);
    rates(y, s->u + at[stage] * h * s->u_rate, k[stage]);
  }
  for (int i = 0; i < 2; i++) s->x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
  s->u += h * s->u_rate;
}

static void start(State *s) {
  State fresh = {0.0, {0.1, 0.0}, 0.0, 0.0};
  *s = fresh;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String uri,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  (void)name, (void)type, (void)visible, (void)logging;
#ifdef BREAK_EXIT
  exit(0);
#endif
#ifndef BREAK_GUID
  if (strcmp(guid, GUID)) return NULL;
#endif
#ifdef BREAK_URI_SLASHES
  if (strncmp(uri, "file:///", 8)) return NULL;
#endif
#ifdef BREAK_URI_PERCENT
  FILE *folder = fopen(uri + 7, "r");
  if (!strncmp(uri, "file:///", 8) && !folder) return NULL;
  if (folder) fclose(folder);
#endif
  (void)guid, (void)uri;
  Spring *s = callbacks->allocateMemory(1, sizeof *s);
  if (!s) return NULL;
  s->callbacks = *callbacks;
  s->scratch = callbacks->allocateMemory(1, 16);
  start(NOW(s));
  return s;
}

void fmi2FreeInstance(fmi2Component c) {
  Spring *s = c;
  if (!s) return;
#ifndef BREAK_MEMORY
  s->callbacks.freeMemory(s->scratch);
#endif
  s->callbacks.freeMemory(s);
}

fmi2Status fmi2Reset(fmi2Component c) {
#ifndef BREAK_RESET
  start(NOW((Spring *)c));
#endif
  (void)c;
  return fmi2OK;
}

static double value_of(const State *s, unsigned which) {
  double dx[2];
  rates(s->x, s->u, dx);
  switch (which) {
    case PULL: return s->u;
    case POSITION: return s->x[0];
    case VELOCITY: return s->x[1];
    case POSITION_RATE: return dx[0];
    case VELOCITY_RATE: return dx[1];
#ifdef BREAK_NAN
    case FORCE: return 0.0 / (s->time - s->time);
#endif
    default: return STIFFNESS * (s->u - s->x[0]);
  }
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
  for (size_t i = 0; i < n; i++) {
    if (r[i] >= VARIABLES) return fmi2Error;
    value[i] = value_of(NOW((Spring *)c), r[i]);
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[]) {
  State *s = NOW((Spring *)c);
  for (size_t i = 0; i < n; i++) {
    if (r[i] > VELOCITY) return fmi2Error;
    if (r[i] == PULL) s->u = value[i], s->u_rate = 0.0;
    else s->x[r[i] - POSITION] = value[i];
  }
  return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
  if (!*state) *state = malloc(sizeof(State));
  memcpy(*state, NOW((Spring *)c), sizeof(State));
  return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  State *s = NOW((Spring *)c);
#ifdef BREAK_STATE
  double kept = s->x[1];
#endif
  memcpy(s, state, sizeof *s);
#ifdef BREAK_STATE
  s->x[1] = kept;
#endif
  return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  (void)c, (void)state;
  *size = sizeof(State);
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  (void)c;
#ifdef BREAK_SERIALISATION
  /* an address means nothing in another process, but a copy of it lives on here */
  State *copy = malloc(sizeof *copy);
  memcpy(copy, state, sizeof *copy);
  memset(bytes, 0, size);
  memcpy(bytes, &copy, sizeof copy);
#else
  memcpy(bytes, state, size);
#endif
  return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  (void)c;
  if (!*state) *state = malloc(sizeof(State));
#ifdef BREAK_SERIALISATION
  State *copy;
  memcpy(&copy, bytes, sizeof copy);
  memcpy(*state, copy, sizeof *copy);
  (void)size;
#else
  memcpy(*state, bytes, size);
#endif
  return fmi2OK;
}

/* change of a variable that a change of u and x makes */
static double change_of(unsigned which, double u, const double *x) {
  double dx[2];
  rates(x, u, dx);
  switch (which) {
    case POSITION: return x[0];
    case VELOCITY: return x[1];
    case POSITION_RATE: return dx[0];
    case VELOCITY_RATE: return dx[1];
    default: return STIFFNESS * (u - x[0]);
  }
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference known[], size_t m, const fmi2Real dknown[],
                                        fmi2Real dunknown[]) {
  double u = 0.0, x[2] = {0.0, 0.0};
  (void)c;
  for (size_t i = 0; i < m; i++) {
    if (known[i] > VELOCITY) return fmi2Error;
    if (known[i] == PULL) u += dknown[i];
    else x[known[i] - POSITION] += dknown[i];
  }
  for (size_t i = 0; i < n; i++) dunknown[i] = change_of(unknown[i], u, x);
#ifdef BREAK_DIRECTIONAL
  for (size_t i = 0; i < n; i++) dunknown[i] *= 1.01;
#endif
  return fmi2OK;
}

/* co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean no_set_state) {
  State *s = NOW((Spring *)c);
  (void)no_set_state;
#ifdef BREAK_STEP
  h = 0.01;
#endif
#ifdef BREAK_CRASH
  if (time > 0.5) abort();
#endif
#ifdef BREAK_HANG
  while (time > 0.5) time += 1e-9 * (h > 0.0);
#endif
#ifdef BREAK_INPUT_DERIVATIVES
  s->u_rate = 0.0;
#endif
#ifdef BREAK_INTERFACES
  s->x[0] *= 1.02;
#endif
  int parts = 1 + (int)(h / LARGEST_STEP);
  for (int part = 0; part < parts; part++) runge_kutta(s, h / parts);
  s->time = time + h;
  return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[]) {
  for (size_t i = 0; i < n; i++) {
    if (r[i] != PULL || order[i] != 1) return fmi2Error;
    NOW((Spring *)c)->u_rate = value[i];
  }
  return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
  State *s = NOW((Spring *)c);
  for (size_t i = 0; i < n; i++) {
    if (order[i] != 1) return fmi2Error;
    value[i] = r[i] == POSITION ? s->x[1] : STIFFNESS * (s->u_rate - s->x[1]);
#ifdef BREAK_OUTPUT_DERIVATIVES
    value[i] = -value[i];
#endif
  }
  return fmi2OK;
}

/* model exchange */

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
  NOW((Spring *)c)->time = time;
  return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  memcpy(NOW((Spring *)c)->x, x, n * sizeof *x);
  return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  memcpy(x, NOW((Spring *)c)->x, n * sizeof *x);
  return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
  State *s = NOW((Spring *)c);
  (void)n;
  rates(s->x, s->u, dx);
#ifdef BREAK_DERIVATIVES
  dx[1] += s->u_rate;
  s->u_rate += 1.0;
#endif
  return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  (void)c;
  for (size_t i = 0; i < n; i++) x[i] = 1.0;
  return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  (void)c;
  memset(info, 0, sizeof *info);
  return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *event, fmi2Boolean *end) {
  (void)c, (void)no_set_state;
  *event = *end = fmi2False;
  return fmi2OK;
}

/* what has nothing to do here */

#ifdef BREAK_VERSION
const char *fmi2GetVersion(void) { return "1.0"; }
#else
const char *fmi2GetVersion(void) { return fmi2Version; }
#endif
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

#define NOTHING(name, arguments, status) \
  fmi2Status name arguments { return status; }
#define GET(name, type) \
  NOTHING(fmi2Get##name, (fmi2Component c, const fmi2ValueReference r[], size_t n, type v[]), \
          ((void)c, (void)r, (void)v, n ? fmi2Error : fmi2OK))
#define SET(name, type) \
  NOTHING(fmi2Set##name, (fmi2Component c, const fmi2ValueReference r[], size_t n, const type v[]), \
          ((void)c, (void)r, (void)v, n ? fmi2Error : fmi2OK))
#define MODE(name) NOTHING(fmi2##name, (fmi2Component c), ((void)c, fmi2OK))
#define STATUS(name, type) \
  NOTHING(fmi2Get##name, (fmi2Component c, const fmi2StatusKind k, type *v), ((void)c, (void)k, (void)v, fmi2Discard))

GET(Integer, fmi2Integer)
GET(Boolean, fmi2Boolean)
GET(String, fmi2String)
SET(Integer, fmi2Integer)
SET(Boolean, fmi2Boolean)
SET(String, fmi2String)
MODE(EnterInitializationMode)
MODE(ExitInitializationMode)
MODE(Terminate)
MODE(EnterEventMode)
MODE(EnterContinuousTimeMode)
#ifndef BREAK_EXPORTS
MODE(CancelStep)
#endif
STATUS(Status, fmi2Status)
STATUS(RealStatus, fmi2Real)
STATUS(IntegerStatus, fmi2Integer)
STATUS(BooleanStatus, fmi2Boolean)
STATUS(StringStatus, fmi2String)
NOTHING(fmi2SetDebugLogging, (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]),
        ((void)c, (void)on, (void)n, (void)names, fmi2OK))
NOTHING(fmi2SetupExperiment,
        (fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real from, fmi2Boolean ends, fmi2Real to),
        ((void)has_tolerance, (void)tolerance, (void)ends, (void)to, NOW((Spring *)c)->time = from, fmi2OK))
NOTHING(fmi2GetEventIndicators, (fmi2Component c, fmi2Real z[], size_t n), ((void)c, (void)z, (void)n, fmi2OK))

#ifdef BREAK_VISIBILITY
void helper_of_mine(void);
void helper_of_mine(void) {}
#endif

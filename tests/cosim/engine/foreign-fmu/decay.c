/* A plain FMI 2.0 co-simulation FMU as another tool might make it: x' = rate (u - x), y = 2 x, no input derivatives,
 * outputs of all types, messages with format arguments, and without the functions that nobody calls. `trouble` makes it fail from 0.5 s
 * on, crash, hang or exit, give NaN for derivatives, forget what was set, take its time or, at any time, get through 0.03 s of a step
 * at most; it crashes when it is loaded where DECAY_CRASHES says so, has one instance in a process where DECAY_ONCE does, and
 * prints where DECAY_PRINTS does. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { NONE = 1, FAILS, ENDS, FORGETS, ABORTS, CRASHES, HANGS, EXITS, DISCARDS, NAN_FIRST, NAN_ALWAYS, NAN_LATER, REFUSES, RESETS, IGNORES, LINGERS, STUMBLES };

typedef struct {
  const fmi2CallbackFunctions *callbacks;
  double x, u, rate, time;
  int trouble, steps, inverted, asked, discarded;
  char label[32], said[64];
} decay;

static int made = 0;
int decay_instances = 0; /* how many are alive, for the tests */

#if defined(__GNUC__)
__attribute__((constructor)) static void loaded(void) {
  if (getenv("DECAY_CRASHES") != NULL) abort();
}
#endif

static void get_into(int trouble) {
  if (trouble == ABORTS) abort();
  if (trouble == CRASHES) *(volatile int *)8 = 0;
  for (volatile int forever = trouble == HANGS; forever;) continue;
  if (trouble == EXITS) exit(0);
}

static fmi2Status say(decay *d, fmi2Status status) {
  d->callbacks->logger(d->callbacks->componentEnvironment, d->label, status, "logStatusError", "%s is tired after %d steps", d->label,
                       d->steps);
  return status;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  (void)name, (void)type, (void)resources, (void)visible, (void)logging;
  if (strcmp(guid, "decay") != 0) return NULL;
  if (getenv("DECAY_ONCE") != NULL && made++) return NULL;
  if (getenv("DECAY_PRINTS") != NULL) puts("a licence of 1000 lines");
  decay *d = calloc(1, sizeof *d);
  d->callbacks = callbacks;
  d->x = 1.0;
  d->rate = 1.0;
  d->trouble = NONE;
  strcpy(d->label, "decay");
  decay_instances++;
  return d;
}

void fmi2FreeInstance(fmi2Component c) {
  decay_instances--;
  free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real start, fmi2Boolean stops,
                               fmi2Real stop) {
  (void)defined, (void)tolerance, (void)stops, (void)stop;
  ((decay *)c)->time = start;
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  decay *d = c;
  if (d->trouble == RESETS) d->rate = 1.0, d->u = 0.0, strcpy(d->label, "decay");
  return d->rate < 0.0 ? say(c, fmi2Error) : fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  const decay *d = c;
  for (size_t i = 0; i < n; i++) value[i] = vr[i] == 0 ? d->x : vr[i] == 1 ? d->u : vr[i] == 3 ? 2.0 * d->x : d->rate;
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  decay *d = c;
  for (size_t i = 0; i < n; i++) *(vr[i] == 0 ? &d->x : vr[i] == 1 ? &d->u : &d->rate) = value[i];
  if (d->trouble == IGNORES) d->rate = 1.0;
  return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
                                        fmi2Real value[]) {
  decay *d = c;
  (void)order;
  for (size_t i = 0; i < n; i++) {
    int absent = d->trouble == NAN_ALWAYS || (d->trouble == NAN_FIRST && d->steps == 0) ||
                 (d->trouble == NAN_LATER && vr[i] == 3 && d->time > 0.5 + 1e-9);
    if (d->trouble == REFUSES && vr[i] == 3) return say(d, fmi2Error);
    value[i] = absent ? NAN : (vr[i] == 3 ? 2.0 : 1.0) * d->rate * (d->u - d->x);
  }
  return fmi2OK;
}

#define WHOLE(Kind, place)                                                                                               \
  fmi2Status fmi2Get##Kind(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##Kind value[]) {               \
    decay *d = c;                                                                                                        \
    for (size_t i = 0; i < n; i++) value[i] = *(vr[i] == 0 ? &d->place : &d->trouble);                                   \
    return fmi2OK;                                                                                                       \
  }                                                                                                                      \
  fmi2Status fmi2Set##Kind(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##Kind value[]) {         \
    decay *d = c;                                                                                                        \
    for (size_t i = 0; i < n; i++) *(vr[i] == 0 ? &d->place : &d->trouble) = value[i];                                   \
    return fmi2OK;                                                                                                       \
  }

WHOLE(Integer, steps)
WHOLE(Boolean, inverted)

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
  (void)vr;
  ((decay *)c)->label[0] = 0;
  for (size_t i = 0; i < n; i++) strncpy(((decay *)c)->label, value[i], sizeof ((decay *)c)->label - 1);
  return fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
  decay *d = c;
  snprintf(d->said, sizeof d->said, "%s, %d", d->label, d->steps);
  for (size_t i = 0; i < n; i++) value[i] = vr[i] == 0 ? d->label : d->said;
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real point, fmi2Real step, fmi2Boolean noSet) {
  (void)noSet;
  decay *d = c;
  if (point + step > 0.5 + 1e-9) {
    if (d->trouble == FAILS) return say(d, fmi2Error);
    if (d->trouble == DISCARDS) return fmi2Discard;
    if (d->trouble == ENDS) {
      d->x *= exp(-d->rate * (0.55 - point));
      d->time = 0.55;
      return fmi2Discard;
    }
    if (d->trouble == FORGETS) d->x = NAN;
    get_into(d->trouble);
  }
  double u = d->inverted ? -d->u : d->u;
  if (d->discarded) return say(d, fmi2Error); /* after fmi2Discard the standard allows to go back, not on */
  d->discarded = d->trouble == STUMBLES && step > 0.03;
  if (d->discarded) step = 0.03;
  d->x = u + (d->x - u) * exp(-d->rate * step);
  d->time = point + step;
  d->steps++;
  d->asked = 0;
  return d->discarded ? fmi2Discard : d->trouble == LINGERS ? fmi2Pending : fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
  if (!*state) *state = malloc(sizeof(decay));
  memcpy(*state, c, sizeof(decay));
  return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  memcpy(c, state, sizeof(decay));
  return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
  if (kind != fmi2DoStepStatus) return fmi2Error;
  *value = ++((decay *)c)->asked < 3 ? fmi2Pending : fmi2OK;
  return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  if (kind == fmi2LastSuccessfulTime) *value = ((decay *)c)->time;
  return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  (void)kind;
  *value = ((decay *)c)->trouble == ENDS;
  return fmi2OK;
}

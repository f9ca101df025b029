/* A plain FMI 2.0 FMU for model exchange alone, as another tool might make it: x' = rate (u - x), and x grows by 1 at time events every
 * 0.25 s, each of two rounds; a step event at 0.6 s counts; the Integer d is taken over at events. It refuses calls in a wrong mode and
 * times before the last completed step, and discards all evaluations more than `patience` after it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { X, U, RATE, PATIENCE, DER_X, REALS };
enum { D, SHOWN, TICKS, STEPS, INTEGERS };
enum { START, EVENTS, CONTINUOUS };

typedef struct {
  double real[REALS], time, completed;
  int integer[INTEGERS], mode, second, counted;
} exchange;

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *callbacks,
                              fmi2Boolean visible, fmi2Boolean logging) {
  (void)name, (void)resources, (void)callbacks, (void)visible, (void)logging;
  if (strcmp(guid, "exchange") != 0 || type != fmi2ModelExchange) return NULL;
  exchange *e = calloc(1, sizeof *e);
  e->real[RATE] = e->real[X] = e->real[PATIENCE] = 1.0;
  return e;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real start, fmi2Boolean stops, fmi2Real stop) {
  (void)defined, (void)tolerance, (void)stops, (void)stop;
  ((exchange *)c)->time = ((exchange *)c)->completed = start;
  return fmi2OK;
}

static fmi2Status change_mode(exchange *e, int from, int to) {
  if (e->mode != from) return fmi2Error;
  e->mode = to;
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return change_mode(c, START, EVENTS); }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return change_mode(c, CONTINUOUS, EVENTS); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return change_mode(c, EVENTS, CONTINUOUS); }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  exchange *e = c;
  if (e->mode != EVENTS) return fmi2Error;
  int ticks = (int)floor(e->time / 0.25 + 1e-12);
  info->valuesOfContinuousStatesChanged = ticks > e->integer[TICKS];
  if (info->valuesOfContinuousStatesChanged) e->real[X] += 1.0;
  e->integer[TICKS] = ticks;
  e->integer[SHOWN] = e->integer[D];
  e->second = !e->second;
  info->newDiscreteStatesNeeded = e->second;
  info->terminateSimulation = info->nominalsOfContinuousStatesChanged = fmi2False;
  info->nextEventTimeDefined = fmi2True;
  info->nextEventTime = 0.25 * (ticks + 1);
  return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSet, fmi2Boolean *enter, fmi2Boolean *ends) {
  exchange *e = c;
  (void)noSet;
  e->completed = e->time;
  *enter = e->time >= 0.6 && !e->counted;
  if (*enter) e->integer[STEPS]++, e->counted = 1;
  *ends = fmi2False;
  return e->mode == CONTINUOUS ? fmi2OK : fmi2Error;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
  exchange *e = c;
  e->time = time;
  return time >= e->completed - 1e-9 ? fmi2OK : fmi2Error;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  ((exchange *)c)->real[X] = x[0];
  return n == 1 && ((exchange *)c)->mode == CONTINUOUS ? fmi2OK : fmi2Error;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { (void)n; x[0] = ((exchange *)c)->real[X]; return fmi2OK; }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { (void)c, (void)n; x[0] = 1.0; return fmi2OK; }
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { (void)c, (void)z, (void)n; return fmi2OK; }

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real x[], size_t n) {
  exchange *e = c;
  (void)n;
  x[0] = e->real[RATE] * (e->real[U] - e->real[X]);
  return e->time <= e->completed + e->real[PATIENCE] ? fmi2OK : fmi2Discard;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  exchange *e = c;
  e->real[DER_X] = e->real[RATE] * (e->real[U] - e->real[X]);
  for (size_t k = 0; k < n; k++) value[k] = e->real[vr[k]];
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  for (size_t k = 0; k < n; k++) ((exchange *)c)->real[vr[k]] = value[k];
  return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
  for (size_t k = 0; k < n; k++) value[k] = ((exchange *)c)->integer[vr[k]];
  return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
  for (size_t k = 0; k < n; k++) ((exchange *)c)->integer[vr[k]] = value[k];
  return ((exchange *)c)->mode == CONTINUOUS ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean v[]) { (void)c, (void)vr, (void)n, (void)v; return fmi2Error; }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean v[]) { (void)c, (void)vr, (void)n, (void)v; return fmi2Error; }

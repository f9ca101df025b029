/* A discrete PID as another tool might export it: a task with one fixed sample time of 1 ms that reads its inputs, calculates
 * and puts out in fmi2DoStep. It refuses any other step, and any gap. `direct` makes it put out what follows from the present
 * inputs whenever it is asked; then fmi2DoStep only moves on to the next sample. Functions that nobody calls are missing. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define JOINTS 2
#define SAMPLE_TIME 1e-3

enum { REFERENCE = 0, POSITION = 2, TORQUE = 4, KP = 6, KI, KD, REALS };

typedef struct {
  const fmi2CallbackFunctions *callbacks;
  double real[REALS], integral[JOINTS], last[JOINTS], time;
  int direct, started;
} task;

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  (void)name, (void)type, (void)resources, (void)visible, (void)logging;
  if (strcmp(guid, "task") != 0) return NULL;
  task *t = calloc(1, sizeof *t);
  t->callbacks = callbacks;
  return t;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real start, fmi2Boolean stops,
                               fmi2Real stop) {
  (void)defined, (void)tolerance, (void)stops, (void)stop;
  ((task *)c)->time = start;
  return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }

/* I_k = I_k-1 + K_i h (e_k + e_k-1) / 2 and K_d (e_k - e_k-1) / h, none of them at the first sample */
static double integral(const task *t, int i, double e) {
  return t->started ? t->integral[i] + t->real[KI] * (SAMPLE_TIME / 2.0) * (e + t->last[i]) : t->integral[i];
}

static double torque(const task *t, int i) {
  double e = t->real[REFERENCE + i] - t->real[POSITION + i];
  double slope = t->started ? t->real[KD] * ((e - t->last[i]) / SAMPLE_TIME) : 0.0;
  return t->real[KP] * e + slope + integral(t, i, e);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  task *t = c;
  for (size_t k = 0; k < n; k++) value[k] = t->direct && vr[k] >= TORQUE && vr[k] < KP ? torque(t, (int)vr[k] - TORQUE) : t->real[vr[k]];
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  for (size_t k = 0; k < n; k++) ((task *)c)->real[vr[k]] = value[k];
  return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
  (void)vr;
  for (size_t k = 0; k < n; k++) ((task *)c)->direct = value[k];
  return fmi2OK;
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
  (void)vr;
  for (size_t k = 0; k < n; k++) value[k] = ((task *)c)->direct;
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real point, fmi2Real step, fmi2Boolean noSet) {
  (void)noSet;
  task *t = c;
  if (fabs(step - SAMPLE_TIME) > 1e-12 || fabs(point - t->time) > 1e-9) {
    t->callbacks->logger(t->callbacks->componentEnvironment, "task", fmi2Error, "logStatusError",
                         "step of %g s at %.12g s instead of %g s at %.12g s", step, point, SAMPLE_TIME, t->time);
    return fmi2Error;
  }
  for (int i = 0; i < JOINTS; i++) {
    double e = t->real[REFERENCE + i] - t->real[POSITION + i];
    t->real[TORQUE + i] = torque(t, i);
    t->integral[i] = integral(t, i, e);
    t->last[i] = e;
  }
  t->started = 1;
  t->time = point + step;
  return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer v[]) { (void)c, (void)vr, (void)n, (void)v; return fmi2Error; }
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer v[]) { (void)c, (void)vr, (void)n, (void)v; return fmi2Error; }

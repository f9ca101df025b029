/* Two instances in two threads, whose runs must equal the run of an instance that is alone. */
#define _POSIX_C_SOURCE 200112L

#include <math.h>
#include <pthread.h>
#include <string.h>

#include "importer.h"

enum { STEPS = 40, THREADS = 2, REPEATS = 3 };

typedef struct {
  double outputs[STEPS][N_REALS + 1];
} record;

static void make_step(fmi2Component c, int k, double *outputs) {
  const fmi2ValueReference input = 0;
  const fmi2Integer order = 1;
  const double rate = 0.1 * sin(0.5 * k);
  if (N_INPUTS > 0) CHECK(fmi2SetRealInputDerivatives(c, &input, 1, &order, &rate) == fmi2OK);
  CHECK(fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2False) == fmi2OK);
  for (fmi2ValueReference vr = 0; vr < N_REALS; vr++) CHECK(fmi2GetReal(c, &vr, 1, outputs + vr) == fmi2OK);
}

// a run with a rollback, step by step; silent and with the C library's memory: nothing that threads share
static void *simulate(void *result) {
  record *record = result;
  const fmi2CallbackFunctions callbacks = {NULL, NULL, NULL, NULL, NULL};
  fmi2Component c = fmi2Instantiate("in a thread", fmi2CoSimulation, GUID, NULL, &callbacks, fmi2False, fmi2False);
  fmi2FMUstate state = NULL;
  CHECK(c != NULL && fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);
  for (int k = 0; k < STEPS; k++) {
    CHECK(fmi2GetFMUstate(c, &state) == fmi2OK);
    make_step(c, k, record->outputs[k]);
    if (k % 7 != 0) continue;
    CHECK(fmi2SetFMUstate(c, state) == fmi2OK);
    make_step(c, k, record->outputs[k]);
  }
  CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK);
  fmi2FreeInstance(c);
  return NULL;
}

int main(void) {
  static record alone, together[THREADS];
  importer_doing = "running alone";
  simulate(&alone);
  for (int repeat = 0; repeat < REPEATS; repeat++) {
    pthread_t threads[THREADS];
    for (int i = 0; i < THREADS; i++) CHECK(pthread_create(threads + i, NULL, simulate, together + i) == 0);
    for (int i = 0; i < THREADS; i++) {
      CHECK(pthread_join(threads[i], NULL) == 0);
      CHECK(memcmp(&alone, together + i, sizeof alone) == 0);
    }
  }
  return 0;
}

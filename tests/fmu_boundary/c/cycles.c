/* Many instances one after the other, each through another part of its life, freed where it stands; then two at once in two
 * threads, whose runs must equal the run of an instance that is alone. */
#define _POSIX_C_SOURCE 200112L

#include <math.h>
#include <pthread.h>
#include <string.h>

#include "importer.h"

enum { STEPS = 40, LIVES = 5, THREADS = 2, REPEATS = 3 };

typedef struct {
  double outputs[STEPS][N_REALS + 1];
} record;

// silent and with the C library's memory: nothing that threads share
static fmi2Component quiet_instance(void) {
  const fmi2CallbackFunctions callbacks = {NULL, NULL, NULL, NULL, NULL};
  fmi2Component c = fmi2Instantiate("in a thread", fmi2CoSimulation, GUID, NULL, &callbacks, fmi2False, fmi2False);
  CHECK(c != NULL);
  return c;
}

static void start(fmi2Component c) {
  CHECK(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);
}

static void make_step(fmi2Component c, int k, double *outputs) {
  const fmi2ValueReference input = 0;
  const fmi2Integer order = 1;
  const double rate = 0.1 * sin(0.5 * k);
  if (N_INPUTS > 0) CHECK(fmi2SetRealInputDerivatives(c, &input, 1, &order, &rate) == fmi2OK);
  CHECK(fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2False) == fmi2OK);
  for (fmi2ValueReference vr = 0; vr < N_REALS; vr++) CHECK(fmi2GetReal(c, &vr, 1, outputs + vr) == fmi2OK);
}

// a run with a rollback, step by step
static void *simulate(void *result) {
  record *record = result;
  fmi2Component c = quiet_instance();
  fmi2FMUstate state = NULL;
  start(c);
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

static void threads_do_not_touch_each_other(void) {
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
}

// lives of different lengths
static void live(int length) {
  importer ear;
  double outputs[N_REALS + 1];
  fmi2FMUstate state = NULL;
  fmi2Component c = importer_instantiate(&ear, fmi2CoSimulation, GUID, fmi2False);
  CHECK(c != NULL && importer_live() > 0);
  if (length > 0) CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
  if (length > 1) CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
  if (length > 2) CHECK(fmi2GetFMUstate(c, &state) == fmi2OK);
  if (length > 2) make_step(c, 0, outputs);
  if (length > 3) CHECK(fmi2SetFMUstate(c, state) == fmi2OK && fmi2Terminate(c) == fmi2OK);
  CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK);
  fmi2FreeInstance(c);
  CHECK(importer_live() == 0);
}

int main(int argc, char **argv) {
  int cycles = argc > 1 ? atoi(argv[1]) : 2000;
  importer_doing = "living and dying";
  for (int i = 0; i < cycles; i++) live(i % LIVES);
  if (argc > 2) threads_do_not_touch_each_other();
  printf("%d cycles\n", cycles);
  return 0;
}

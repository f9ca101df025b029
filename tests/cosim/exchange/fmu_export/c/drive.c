/* A life of any FMU under the sanitizers: all functions in all states, good and bad arguments, rollback in uneven steps.
 * It prints nothing and checks little; the sanitizers judge. Defined on the command line: GUID, N_REALS, N_INPUTS. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#define CHECK(condition)                                     \
  do {                                                       \
    if (!(condition)) {                                      \
      printf("%d: not true: %s\n", __LINE__, #condition);    \
      exit(1);                                               \
    }                                                        \
  } while (0)

static void hear(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
  (void)environment, (void)name, (void)status, (void)category;
  if (strlen(message) == 0) exit(2);
}

// every variable, those beyond the last included
static void touch(fmi2Component c, int seed) {
  for (fmi2ValueReference vr = 0; vr < N_REALS + 2; vr++) {
    double value = 0.0;
    int order = 1 + (int)vr % 4, integer = 1 + seed % 2;
    fmi2GetReal(c, &vr, 1, &value);
    if (vr < N_INPUTS || vr >= N_REALS) {
      value = 0.1 * (seed % 7);
      fmi2SetReal(c, &vr, 1, &value);
    }
    fmi2SetRealInputDerivatives(c, &vr, 1, &order, &value);
    fmi2GetRealOutputDerivatives(c, &vr, 1, &order, &value);
    fmi2GetInteger(c, &vr, 1, &integer);
    fmi2SetInteger(c, &vr, 1, &integer);
    order = 99;
    fmi2SetRealInputDerivatives(c, &vr, 1, &order, &value);
    fmi2GetRealOutputDerivatives(c, &vr, 1, &order, &value);
  }
}

static fmi2Component begin(const fmi2CallbackFunctions *callbacks) {
  fmi2Component c = fmi2Instantiate("a life", fmi2CoSimulation, GUID, NULL, callbacks, fmi2False, fmi2True);
  CHECK(c != NULL);
  touch(c, 1);
  CHECK(fmi2SetupExperiment(c, fmi2True, 1e-9, 0.0, fmi2False, 0.0) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
  touch(c, 2);
  CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
  return c;
}

int main(void) {
  const fmi2CallbackFunctions callbacks = {hear, NULL, NULL, NULL, NULL}, deaf = {NULL, NULL, NULL, NULL, NULL};
  fmi2Component c = begin(&callbacks), other = begin(&deaf);
  fmi2FMUstate state = NULL, copy = NULL;
  double time = 0.0, saved_time = 0.0;

  // uneven steps, with a way back now and then
  for (int n = 0; n < 300; n++) {
    double step = 1e-3 * (0.1 + 0.45 * (n % 9));
    touch(c, n);
    CHECK(fmi2DoStep(c, time, step, fmi2False) == fmi2OK);
    time += step;
    if (n % 50 == 10) {
      CHECK(fmi2GetFMUstate(c, &state) == fmi2OK);
      saved_time = time;
    }
    if (n % 50 == 40) {
      CHECK(fmi2SetFMUstate(c, state) == fmi2OK);
      time = saved_time;
    }
  }

  // a state on its way to another instance
  size_t size = 0;
  CHECK(fmi2SerializedFMUstateSize(c, state, &size) == fmi2OK);
  char *bytes = malloc(size);
  CHECK(fmi2SerializeFMUstate(c, state, bytes, size) == fmi2OK);
  CHECK(fmi2SerializeFMUstate(c, state, bytes, size - 1) == fmi2Error);
  CHECK(fmi2DeSerializeFMUstate(other, bytes, size, &copy) == fmi2OK);
  CHECK(fmi2SetFMUstate(other, copy) == fmi2OK);
  CHECK(fmi2DoStep(other, saved_time, 1e-3, fmi2True) == fmi2OK);
  bytes[size - 1] ^= 1;
  fmi2FMUstate none = NULL;
  CHECK(fmi2DeSerializeFMUstate(other, bytes, size, &none) == fmi2Error);
  CHECK(fmi2DeSerializeFMUstate(other, bytes, 3, &none) == fmi2Error);
  free(bytes);
  CHECK(fmi2FreeFMUstate(other, &copy) == fmi2OK);
  CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK);

  // one large step, a new life, the end
  CHECK(fmi2DoStep(c, time, 5.0, fmi2True) == fmi2OK);
  touch(c, 5);
  CHECK(fmi2Terminate(c) == fmi2OK);
  touch(c, 6);
  CHECK(fmi2DoStep(c, time, 1e-3, fmi2True) == fmi2Error);
  CHECK(fmi2Reset(c) == fmi2OK);
  touch(c, 7);
  fmi2FreeInstance(c);
  fmi2FreeInstance(other);
  CHECK(fmi2Instantiate("x", fmi2CoSimulation, "another", NULL, &deaf, fmi2False, fmi2False) == NULL);
  return 0;
}

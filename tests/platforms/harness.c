/* Runs a motion-driven robot FMU on any platform and prints every output at every step, exactly.

   harness LIBRARY GUID OUTPUTS FIRST_OUTPUT STEPS STEP

   The motors start with a constant jerk, as input derivatives that go on for all steps, so that the inputs are the same numbers
   everywhere, whatever the platform's mathematics library makes of sines. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

#ifdef _WIN32
#include <windows.h>
static void *load(const char *path) { return (void *)LoadLibraryA(path); }
static void *find(void *library, const char *name) { return (void *)GetProcAddress((HMODULE)library, name); }
#else
#include <dlfcn.h>
static void *load(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void *find(void *library, const char *name) { return dlsym(library, name); }
#endif

#define JERK 150.0
#define MAX_OUTPUTS 256

static void show(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
  (void)environment;
  fprintf(stderr, "%s: status %d, %s: %s\n", instance, (int)status, category, message);
}

static void check(fmi2Status status, const char *what) {
  if (status != fmi2OK) {
    fprintf(stderr, "%s gave status %d\n", what, (int)status);
    exit(1);
  }
}

/* function name of the FMU's library, of its own type */
#define FIND(type, name) type##TYPE *name = (type##TYPE *)find(library, #type)

int main(int argc, char **argv) {
  if (argc != 7) return 2;
  void *library = load(argv[1]);
  if (!library) {
    fprintf(stderr, "cannot load %s\n", argv[1]);
    return 1;
  }
  FIND(fmi2Instantiate, instantiate);
  FIND(fmi2SetupExperiment, setup);
  FIND(fmi2EnterInitializationMode, enter);
  FIND(fmi2ExitInitializationMode, leave);
  FIND(fmi2SetRealInputDerivatives, set_derivatives);
  FIND(fmi2GetReal, get);
  FIND(fmi2DoStep, step_on);
  FIND(fmi2Terminate, terminate);
  FIND(fmi2FreeInstance, release);

  const size_t n = (size_t)atoi(argv[3]);
  const int steps = atoi(argv[5]);
  const double step = strtod(argv[6], NULL), duration = steps * step;
  fmi2ValueReference outputs[MAX_OUTPUTS];
  for (size_t i = 0; i < n; i++) outputs[i] = (fmi2ValueReference)(atoi(argv[4]) + (int)i);

  const fmi2CallbackFunctions callbacks = {show, calloc, free, NULL, NULL};
  fmi2Component robot = instantiate("robot", fmi2CoSimulation, argv[2], "file:///nowhere", &callbacks, fmi2False, fmi2False);
  if (!robot) return 1;
  check(setup(robot, fmi2True, 1e-8, 0.0, fmi2True, duration), "fmi2SetupExperiment");
  check(enter(robot), "fmi2EnterInitializationMode");
  check(leave(robot), "fmi2ExitInitializationMode");

  /* position, velocity, acceleration of both motors */
  const fmi2ValueReference inputs[6] = {0, 1, 2, 3, 4, 5};
  const fmi2Integer orders[6] = {3, 3, 2, 2, 1, 1};
  const double rates[6] = {JERK, JERK, JERK, JERK, JERK, JERK};
  check(set_derivatives(robot, inputs, 6, orders, rates), "fmi2SetRealInputDerivatives");
  for (int k = 0; k < steps; k++) {
    check(step_on(robot, k * step, step, fmi2True), "fmi2DoStep");
    double results[MAX_OUTPUTS];
    check(get(robot, outputs, n, results), "fmi2GetReal");
    for (size_t i = 0; i < n; i++) printf("%a ", results[i]);
    printf("\n");
  }
  check(terminate(robot), "fmi2Terminate");
  release(robot);
  return 0;
}

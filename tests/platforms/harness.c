/* Runs a motion-driven robot FMU on any platform and prints every output at every step, exactly.

   harness LIBRARY GUID OUTPUTS FIRST_OUTPUT STEPS STEP Q1 Q2

   The motors go from their start angles by 0.2 rad along polynomials, so that the inputs are the same numbers everywhere,
   whatever the platform's mathematics library makes of sines. */
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

#define TRAVEL 0.2
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

/* 10 x^3 - 15 x^4 + 6 x^5 and its derivatives with respect to x */
static void blend(double x, double d[5]) {
  d[0] = x * x * x * (10.0 + x * (-15.0 + 6.0 * x));
  d[1] = x * x * (30.0 + x * (-60.0 + 30.0 * x));
  d[2] = x * (60.0 + x * (-180.0 + 120.0 * x));
  d[3] = 60.0 + x * (-360.0 + 360.0 * x);
  d[4] = -360.0 + 720.0 * x;
}

int main(int argc, char **argv) {
  if (argc != 9) return 2;
  void *library = load(argv[1]);
  if (!library) {
    fprintf(stderr, "cannot load %s\n", argv[1]);
    return 1;
  }
  FIND(fmi2Instantiate, instantiate);
  FIND(fmi2SetupExperiment, setup);
  FIND(fmi2EnterInitializationMode, enter);
  FIND(fmi2ExitInitializationMode, leave);
  FIND(fmi2SetReal, set);
  FIND(fmi2SetRealInputDerivatives, set_derivatives);
  FIND(fmi2GetReal, get);
  FIND(fmi2DoStep, step_on);
  FIND(fmi2Terminate, terminate);
  FIND(fmi2FreeInstance, release);

  const size_t n = (size_t)atoi(argv[3]);
  const int steps = atoi(argv[5]);
  const double step = strtod(argv[6], NULL), duration = steps * step;
  const double start[2] = {strtod(argv[7], NULL), strtod(argv[8], NULL)};
  fmi2ValueReference outputs[MAX_OUTPUTS];
  for (size_t i = 0; i < n; i++) outputs[i] = (fmi2ValueReference)(atoi(argv[4]) + (int)i);

  const fmi2CallbackFunctions callbacks = {show, calloc, free, NULL, NULL};
  fmi2Component robot = instantiate("robot", fmi2CoSimulation, argv[2], "file:///nowhere", &callbacks, fmi2False, fmi2False);
  if (!robot) return 1;
  check(setup(robot, fmi2True, 1e-8, 0.0, fmi2True, duration), "fmi2SetupExperiment");
  check(enter(robot), "fmi2EnterInitializationMode");
  check(leave(robot), "fmi2ExitInitializationMode");

  for (int k = 0; k < steps; k++) {
    double d[5], values[6], rates[12];
    fmi2ValueReference inputs[6], rate_inputs[12];
    fmi2Integer orders[12];
    blend((double)k / steps, d);
    for (int kind = 0; kind < 3; kind++) { /* position, velocity, acceleration of both motors, with two rates each */
      const double scale = TRAVEL / (kind == 0 ? 1.0 : kind == 1 ? duration : duration * duration);
      for (int motor = 0; motor < 2; motor++) {
        const int i = 2 * kind + motor;
        inputs[i] = rate_inputs[i] = rate_inputs[6 + i] = (fmi2ValueReference)i;
        values[i] = scale * d[kind] + (kind ? 0.0 : start[motor]);
        orders[i] = 1;
        orders[6 + i] = 2;
        rates[i] = scale / duration * d[kind + 1];
        rates[6 + i] = kind + 2 < 5 ? scale / (duration * duration) * d[kind + 2] : 0.0;
      }
    }
    check(set(robot, inputs, 6, values), "fmi2SetReal");
    check(set_derivatives(robot, rate_inputs, 12, orders, rates), "fmi2SetRealInputDerivatives");
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

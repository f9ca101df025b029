/* What a run of an FMU costs, from within: the FMI calls of a co-simulation, and the generated functions one by one.
 *
 * The table holds, as doubles: communication step, number of steps, inputs, highest order of their derivatives, then for every
 * step the inputs and their derivatives by order. Processor times are in seconds, the best of several runs. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "fmi2Functions.h"
#include "variables.h"

#define CALLS 2000

typedef struct {
  double step;
  int count, m, order;
  const double *values;
} table;

/* which calls are made in a run */
enum { STEPS, OUTPUTS, RATES, DEPTHS };

static double now(void) {
  return (double)clock() / CLOCKS_PER_SEC;
}

static void fail(const char *what) {
  fprintf(stderr, "fmu_cost: %s\n", what);
  exit(1);
}

static table read_table(const char *path) {
  FILE *file = fopen(path, "rb");
  if (!file) fail("no such table");
  double head[4];
  if (fread(head, sizeof *head, 4, file) != 4) fail("the table has no head");
  table read = {head[0], (int)head[1], (int)head[2], (int)head[3], NULL};
  size_t size = (size_t)read.count * (size_t)read.m * (size_t)(read.order + 1);
  double *values = malloc(size * sizeof *values);
  if (!values || fread(values, sizeof *values, size, file) != size) fail("the table is too short");
  fclose(file);
  read.values = values;
  return read;
}

static void silent(fmi2ComponentEnvironment e, fmi2String n, fmi2Status s, fmi2String c, fmi2String m, ...) {
  (void)e, (void)n, (void)c;
  if (s > fmi2Warning) fail(m);
}

static void check(fmi2Status status) {
  if (status != fmi2OK) fail("an FMI call failed");
}

static fmi2Component make(double tolerance, int integrator) {
  static const fmi2CallbackFunctions callbacks = {silent, calloc, free, NULL, NULL};
  fmi2Component fmu = fmi2Instantiate("cost", fmi2CoSimulation, flex_the_model.guid, "", &callbacks, fmi2False, fmi2False);
  if (!fmu) fail("no instance");
  const fmi2ValueReference reference = FLEX_INTEGRATOR;
  check(fmi2SetInteger(fmu, &reference, 1, &integrator));
  check(fmi2SetupExperiment(fmu, fmi2True, tolerance, 0.0, fmi2False, 0.0));
  check(fmi2EnterInitializationMode(fmu));
  return fmu;
}

/* one run; returns its time without instantiation */
static double run(const table *inputs, double tolerance, int integrator, int depth, int *statistics) {
  int m = inputs->m, n_outputs = flex_the_model.n_outputs, first = m + flex_the_model.n_parameters, order = inputs->order;
  fmi2ValueReference reference[1024], wanted[2048];
  fmi2Integer orders[1024], wanted_orders[2048];
  static double results[2048];
  if (m * order > 1024 || 2 * n_outputs > 2048) fail("too many variables");
  for (int k = 0; k <= order; k++)
    for (int i = 0; i < m; i++) reference[k * m + i] = (unsigned)i, orders[k * m + i] = k;
  for (int k = 0; k < 2; k++)
    for (int i = 0; i < n_outputs; i++)
      wanted[k * n_outputs + i] = (unsigned)(first + i), wanted_orders[k * n_outputs + i] = k + 1;

  fmi2Component fmu = make(tolerance, integrator);
  check(fmi2SetReal(fmu, reference, (size_t)m, inputs->values));
  check(fmi2ExitInitializationMode(fmu));
  double started = now();
  for (int k = 0; k < inputs->count; k++) {
    const double *u = inputs->values + k * m * (order + 1);
    check(fmi2SetReal(fmu, reference, (size_t)m, u));
    if (order > 0) check(fmi2SetRealInputDerivatives(fmu, reference + m, (size_t)(m * order), orders + m, u + m));
    if (fmi2DoStep(fmu, k * inputs->step, inputs->step, fmi2True) != fmi2OK) fail("a step failed");
    if (depth >= OUTPUTS) check(fmi2GetReal(fmu, wanted, (size_t)n_outputs, results));
    if (depth >= RATES) check(fmi2GetRealOutputDerivatives(fmu, wanted, (size_t)(2 * n_outputs), wanted_orders, results));
  }
  double taken = now() - started;
  const fmi2ValueReference counters[5] = {1, 2, 3, 4, 5};
  check(fmi2GetInteger(fmu, counters, 5, statistics));
  check(fmi2Terminate(fmu));
  fmi2FreeInstance(fmu);
  return taken;
}

/* a plant in the middle of the motion */
static flex_plant *halfway(const table *inputs) {
  flex_plant *plant = flex_plant_create(&flex_the_model, calloc(1, flex_plant_size(&flex_the_model)));
  int m = inputs->m, count = inputs->count / 3;
  for (int k = 0; k <= count; k++) {
    const double *u = inputs->values + k * m * (inputs->order + 1);
    for (int i = 0; i < m; i++) flex_inputs_set(&plant->inputs, i, plant->record->time, u[i]);
    for (int o = 1; o <= inputs->order; o++)
      for (int i = 0; i < m; i++) flex_inputs_set_derivative(&plant->inputs, i, plant->record->time, o, u[o * m + i]);
    flex_plant_inputs_changed(plant);
    if (k == 0 && flex_plant_begin(plant).outcome != FLEX_DONE) fail("the motion cannot begin");
    if (k == count) break;
    if (flex_plant_advance(plant, k * inputs->step, (k + 1) * inputs->step).outcome != FLEX_DONE) fail("a step failed");
  }
  flex_plant_need_rates(plant, 2);
  plant->equations.w = plant->shared; // which the second rates need as the first ones left it
  return plant;
}

/* time of one call of a generated function */
static double call_time(flex_plant *plant, const flex_function *function, int count, const double *const *arguments) {
  static double result[100000];
  double started = now();
  for (int i = 0; i < CALLS; i++)
    if (flex_call(&plant->equations, function, count, arguments, result)) fail("a function refused");
  return (now() - started) / CALLS;
}

static double least(double a, double b) {
  return a < b ? a : b;
}

/* what is measured, in this order: counters; whether steps end in a stage, 0 or 1; runs that go as far; calls of generated
 * functions */
enum { COUNTERS = 5, ENDS_IN_STAGE = COUNTERS, RUNS, FUNCTIONS = RUNS + DEPTHS, FIGURES = FUNCTIONS + 6 };

__attribute__((visibility("default"))) void fmu_cost(const char *path, double tolerance, int integrator, int repeat,
                                                     double *figures) {
  const table inputs = read_table(path);
  int statistics[COUNTERS] = {0};
  const flex_model *model = &flex_the_model;
  flex_plant *p = halfway(&inputs);
  const double *y = p->integrator.y, *v = p->integrator.v, *a = p->integrator.a, *u = p->u, *u1 = p->u1, *u2 = p->u2, *d = p->d;
  const double *const plain[] = {y, v, a, u, d}, *const position[] = {y, u, d},
                      *const first[] = {y, v, a, u, u1, d}, *const second[] = {y, v, a, u, u1, d, p->jerk, u2};
  const struct {
    const flex_function *function;
    int count;
    const double *const *arguments;
  } functions[] = {{&model->residual, 5, plain},       {&model->mass_matrix, 3, position},
                   {&model->singularity, 3, position}, {&model->outputs, 5, plain},
                   {&model->motion_rate1, 6, first}, {&model->motion_rate2, 8, second}};
  for (int i = RUNS; i < FIGURES; i++) figures[i] = HUGE_VAL;

  // in rounds, because a machine is faster at one moment than at another
  for (int k = 0; k < repeat; k++) {
    for (int depth = 0; depth < DEPTHS; depth++)
      figures[RUNS + depth] = least(figures[RUNS + depth], run(&inputs, tolerance, integrator, depth, statistics));
    for (int i = 0; i < FIGURES - FUNCTIONS; i++) {
      double time = call_time(p, functions[i].function, functions[i].count, functions[i].arguments);
      figures[FUNCTIONS + i] = least(figures[FUNCTIONS + i], time);
    }
  }
  for (int i = 0; i < COUNTERS; i++) figures[i] = statistics[i];
  const flex_tableau *collocation = flex_find_method(integrator, tolerance, model->is_damped, p->record->is_overdamped)->collocation;
  figures[ENDS_IN_STAGE] = collocation != NULL && flex_ends_in_stage(collocation);
  free(p);
  free((void *)inputs.values);
}

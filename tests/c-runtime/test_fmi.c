/* The FMI functions, called as an importer calls them. The model is `fragile`: y'' + y = force + load. */
#include <stdarg.h>
#include <string.h>

#include "check.h"
#include "fmi2Functions.h"
#include "models.h"
#include "tests.h"

enum { FORCE, LIMIT, LOAD, POSITION, FIXED_STEP };
enum { INITIAL, STEPS, INTEGRATOR = 6 };

/* what the importer hears and gives, per instance */
typedef struct {
  char message[1024], category[64];
  int n_messages, n_allocations, n_live;
} importer;

static void hear(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
  importer *ear = environment;
  (void)name, (void)status;
  va_list arguments;
  va_start(arguments, message);
  vsnprintf(ear->message, sizeof ear->message, message, arguments);
  va_end(arguments);
  snprintf(ear->category, sizeof ear->category, "%s", category);
  ear->n_messages++;
}

static importer *payer; // whose memory is being taken

static void *give(size_t count, size_t size) {
  payer->n_allocations++;
  payer->n_live++;
  return calloc(count, size);
}

static void take_back(void *memory) {
  if (memory) payer->n_live--;
  free(memory);
}

static fmi2Component instantiate_for(fmi2Type type, importer *ear, const char *guid) {
  memset(ear, 0, sizeof *ear);
  payer = ear;
  const fmi2CallbackFunctions callbacks = {hear, give, take_back, NULL, ear};
  return fmi2Instantiate("test", type, guid, "file:///nowhere at all", &callbacks, fmi2False, fmi2False);
}

static fmi2Component instantiate(importer *ear, const char *guid) {
  return instantiate_for(fmi2CoSimulation, ear, guid);
}

// an instance that moves already, with a constant force
static fmi2Component started_for(fmi2Type type, importer *ear, double force) {
  fmi2Component c = instantiate_for(type, ear, flex_the_model.guid);
  const fmi2ValueReference vr = FORCE;
  CHECK(c != NULL);
  CHECK(fmi2SetupExperiment(c, fmi2True, 1e-8, 0.0, fmi2False, 0.0) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
  CHECK(fmi2SetReal(c, &vr, 1, &force) == fmi2OK);
  CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
  return c;
}

static fmi2Component started(importer *ear, double force) {
  return started_for(fmi2CoSimulation, ear, force);
}

static double get(fmi2Component c, fmi2ValueReference vr) {
  double value = NAN;
  CHECK(fmi2GetReal(c, &vr, 1, &value) == fmi2OK);
  return value;
}

static fmi2Status set(fmi2Component c, fmi2ValueReference vr, double value) {
  return fmi2SetReal(c, &vr, 1, &value);
}

static fmi2Status set_derivative(fmi2Component c, int order, double value) {
  const fmi2ValueReference vr = FORCE;
  return fmi2SetRealInputDerivatives(c, &vr, 1, &order, &value);
}

static int get_integer(fmi2Component c, fmi2ValueReference vr) {
  int value = -1;
  CHECK(fmi2GetInteger(c, &vr, 1, &value) == fmi2OK);
  return value;
}

// the way that every importer goes
void test_fmi_life_cycle(void) {
  importer ear;
  fmi2Component c = instantiate(&ear, flex_the_model.guid);
  CHECK(c != NULL);
  CHECK(strcmp(fmi2GetVersion(), "2.0") == 0 && strcmp(fmi2GetTypesPlatform(), "default") == 0);
  CHECK(fmi2SetupExperiment(c, fmi2True, 1e-9, 5.0, fmi2True, 9.0) == fmi2OK);
  CHECK(set(c, FORCE, 0.25) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
  CHECK_CLOSE(get(c, POSITION), 0.25, 1e-15);
  CHECK(set(c, FORCE, 0.5) == fmi2OK);
  CHECK_CLOSE(get(c, POSITION), 0.5, 1e-15);
  CHECK(fmi2ExitInitializationMode(c) == fmi2OK);

  // released at t = 5
  CHECK(set(c, FORCE, 0.0) == fmi2OK);
  for (int k = 0; k < 30; k++) CHECK(fmi2DoStep(c, 5.0 + k * 0.1, 0.1, fmi2True) == fmi2OK);
  CHECK_CLOSE(get(c, POSITION), 0.5 * cos(3.0), 1e-8);
  const fmi2ValueReference position[2] = {POSITION, POSITION};
  const fmi2Integer order[2] = {1, 2};
  double derivative[2], last;
  CHECK(fmi2GetRealOutputDerivatives(c, position, 2, order, derivative) == fmi2OK);
  CHECK_CLOSE(derivative[0], -0.5 * sin(3.0), 1e-8);
  CHECK_CLOSE(derivative[1], -0.5 * cos(3.0), 1e-8);
  CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &last) == fmi2OK);
  CHECK_CLOSE(last, 8.0, 1e-14);
  CHECK(fmi2DoStep(c, 8.0, 1e-20, fmi2True) == fmi2Error && strstr(ear.message, "lost by rounding") != NULL);
  CHECK(get_integer(c, STEPS) >= 30 && get_integer(c, STEPS + 1) >= 0);
  for (fmi2ValueReference statistic = STEPS + 2; statistic < STEPS + 5; statistic++) CHECK(get_integer(c, statistic) > 0);
  const fmi2Integer third = 3;
  CHECK(fmi2GetRealOutputDerivatives(c, position, 1, &third, derivative) == fmi2Error);
  CHECK(strstr(ear.message, "of order 1 or 2, got order 3") != NULL);
  const fmi2ValueReference force = FORCE;
  CHECK(fmi2GetRealOutputDerivatives(c, &force, 1, &order[0], derivative) == fmi2Error);
  CHECK(fmi2SetRealInputDerivatives(c, position, 1, order, derivative) == fmi2Error);
  ear.n_messages = 0;
  CHECK(fmi2Terminate(c) == fmi2OK);
  CHECK_CLOSE(get(c, POSITION), 0.5 * cos(3.0), 1e-8);
  fmi2FreeInstance(c);
  CHECK(ear.n_live == 0 && ear.n_messages == 0);
}

// a binary of another version must not be run with this description
void test_fmi_instantiation_is_checked(void) {
  importer ear;
  CHECK(instantiate(&ear, "{somebody else}") == NULL);
  CHECK(strstr(ear.message, "GUID") != NULL && ear.n_live == 0);

  const fmi2CallbackFunctions bare = {NULL, NULL, NULL, NULL, NULL}, callbacks = {hear, give, take_back, NULL, &ear};
  CHECK(fmi2Instantiate("x", (fmi2Type)2, flex_the_model.guid, NULL, &callbacks, fmi2False, fmi2True) == NULL);
  CHECK(strstr(ear.message, "type") != NULL);
  CHECK(fmi2Instantiate("", fmi2CoSimulation, flex_the_model.guid, NULL, &callbacks, fmi2False, fmi2True) == NULL);
  CHECK(fmi2Instantiate("x", fmi2CoSimulation, flex_the_model.guid, NULL, NULL, fmi2False, fmi2True) == NULL);

  // callbacks may be missing: the C library's memory, nobody to talk to
  fmi2Component c = fmi2Instantiate("x", fmi2CoSimulation, flex_the_model.guid, NULL, &bare, fmi2False, fmi2True);
  CHECK(c != NULL);
  CHECK(fmi2DoStep(c, 0.0, 1.0, fmi2True) == fmi2Error);
  fmi2FreeInstance(c);

  // no instance at all
  double value = 0.0;
  const fmi2ValueReference vr = FORCE;
  CHECK(fmi2DoStep(NULL, 0.0, 1.0, fmi2True) == fmi2Error && fmi2GetReal(NULL, &vr, 1, &value) == fmi2Error);
  CHECK(fmi2EnterInitializationMode(NULL) == fmi2Error && fmi2Reset(NULL) == fmi2Error);
  fmi2FreeInstance(NULL);
}

// a refused value leaves the old one, and the sentence names variable, value, unit and range
void test_fmi_values_are_checked(void) {
  importer ear;
  fmi2Component c = instantiate(&ear, flex_the_model.guid);
  CHECK(set(c, FORCE, NAN) == fmi2Error);
  CHECK(strstr(ear.message, "force must be a finite number in N, got") != NULL);
  CHECK(set(c, FORCE, INFINITY) == fmi2Error);
  CHECK(set(c, FORCE, 101.0) == fmi2Error);
  CHECK(strcmp(ear.message, "force must be in -100 .. 100 N, got 101") == 0);
  CHECK(set(c, LOAD, -5.5) == fmi2Error);
  CHECK(strstr(ear.message, "load must be in -5 .. 5 N, got -5.5") != NULL);
  CHECK(set(c, POSITION, 0.0) == fmi2Error);
  CHECK(strstr(ear.message, "position is an output") != NULL);
  CHECK(set(c, FIXED_STEP, -1e-3) == fmi2Error);
  CHECK(strstr(ear.message, "integrator.step must be in 0 .. inf s, got -0.001") != NULL);
  CHECK(set(c, FIXED_STEP, 1e-3) == fmi2OK && get(c, FIXED_STEP) == 1e-3);
  CHECK(set(c, FIXED_STEP + 1, 0.0) == fmi2Error);
  CHECK(strstr(ear.message, "value reference 5") != NULL);
  double value;
  const fmi2ValueReference position = POSITION;
  CHECK(fmi2GetReal(c, &position, 1, &value) == fmi2Error);
  CHECK(strstr(ear.message, "before fmi2EnterInitializationMode") != NULL);
  CHECK(set_derivative(c, 4, 0.0) == fmi2Error);
  CHECK(strstr(ear.message, "order 1 to 3, got order 4") != NULL);
  CHECK(set_derivative(c, 0, 0.0) == fmi2Error);
  CHECK(set_derivative(c, 1, NAN) == fmi2Error);
  CHECK(get(c, FORCE) == 0.0 && get(c, LOAD) == 0.0);

  const fmi2ValueReference initial = INITIAL, steps = STEPS, unknown = 7, text = 0;
  const fmi2ValueReference integrator = INTEGRATOR;
  const fmi2Integer three = 3, two = 2, eight = 8;
  fmi2Boolean truth = 0;
  CHECK(fmi2SetInteger(c, &initial, 1, &three) == fmi2Error);
  CHECK(strstr(ear.message, "1 (static) or 2 (undeformed), got 3") != NULL);
  CHECK(fmi2SetInteger(c, &steps, 1, &two) == fmi2Error);
  CHECK(fmi2SetInteger(c, &integrator, 1, &eight) == fmi2Error);
  CHECK(strstr(ear.message, "integrator must be 1 (automatic), 2") != NULL);
  CHECK(fmi2SetInteger(c, &integrator, 1, &two) == fmi2OK && get_integer(c, INTEGRATOR) == 2);
  CHECK(fmi2SetInteger(c, &unknown, 1, &two) == fmi2Error);
  CHECK(fmi2SetInteger(c, &initial, 1, &two) == fmi2OK && get_integer(c, INITIAL) == 2);
  CHECK(fmi2SetBoolean(c, &text, 1, &truth) == fmi2Error);

  CHECK(fmi2SetupExperiment(c, fmi2True, 0.0, 0.0, fmi2False, 0.0) == fmi2Error);
  CHECK(fmi2SetupExperiment(c, fmi2True, 1e-6, NAN, fmi2False, 0.0) == fmi2Error);
  CHECK(fmi2SetupExperiment(c, fmi2True, 1e-6, 1.0, fmi2True, 0.5) == fmi2Error);
  CHECK(fmi2SetupExperiment(c, fmi2True, 1e-16, 0.0, fmi2False, 0.0) == fmi2Warning);
  fmi2FreeInstance(c);
}

// a varied force, different in each step
static void drive(fmi2Component c, int first, int last, double *trace) {
  for (int k = first; k < last; k++) {
    CHECK(set(c, FORCE, sin(0.3 * k)) == fmi2OK);
    CHECK(set_derivative(c, 1, cos(0.1 * k)) == fmi2OK);
    CHECK(fmi2DoStep(c, 0.05 * k, 0.05, fmi2False) == fmi2OK);
    trace[k - first] = get(c, POSITION);
  }
}

// masters that repeat steps rely on the same bits: everything the integrator remembers belongs to the state
void test_fmi_rollback_is_exact(void) {
  for (int cut = 0; cut < 60; cut += 7) {
    importer ear;
    fmi2Component c = started(&ear, 0.3);
    double before[60], first[60], second[60];
    fmi2FMUstate state = NULL;
    drive(c, 0, cut, before);
    CHECK(fmi2GetFMUstate(c, &state) == fmi2OK);
    drive(c, cut, 60, first);
    int steps = get_integer(c, STEPS);
    CHECK(fmi2SetFMUstate(c, state) == fmi2OK);
    drive(c, cut, 60, second);
    CHECK(memcmp(first, second, (size_t)(60 - cut) * sizeof(double)) == 0);
    CHECK(get_integer(c, STEPS) == steps);

    // an existing state is reused
    fmi2FMUstate same = state;
    CHECK(fmi2GetFMUstate(c, &state) == fmi2OK && state == same);
    CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK && state == NULL);
    fmi2FreeInstance(c);
    CHECK(ear.n_live == 0);
  }
}

// near a singularity the step is discarded with the reason, the plant stays at the last good time and can go on
void test_fmi_singularity_discards_the_step(void) {
  importer ear;
  fmi2Component c = started(&ear, 0.0);
  CHECK(set_derivative(c, 1, 1.0) == fmi2OK);
  CHECK(fmi2DoStep(c, 0.0, 1.0, fmi2True) == fmi2OK);

  // the margin 2 - t reaches 0.5 at t = 1.5
  CHECK(fmi2DoStep(c, 1.0, 1.0, fmi2True) == fmi2Discard);
  CHECK(strstr(ear.message, "distance between the elbows (m) is 0.") != NULL &&
        strcmp(ear.category, "logStatusDiscard") == 0);
  double last, position;
  fmi2Status status;
  CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &last) == fmi2OK);
  CHECK_CLOSE(last, 1.5, 1e-6);
  CHECK(fmi2GetStatus(c, fmi2DoStepStatus, &status) == fmi2OK && status == fmi2Discard);
  position = get(c, POSITION);
  CHECK_CLOSE(position, last - sin(last), 1e-8);

  // with another force it goes on from there
  CHECK(set(c, FORCE, last) == fmi2OK);
  CHECK_CLOSE(get(c, POSITION), position, 0.0);
  CHECK(set(c, FORCE, 1.0) == fmi2OK);
  CHECK(fmi2DoStep(c, last, 0.5, fmi2True) == fmi2OK);
  CHECK(isfinite(get(c, POSITION)));
  fmi2FreeInstance(c);
}

// NaN from the model never reaches an output
void test_fmi_nan_discards_the_step(void) {
  importer ear;
  fmi2Component c = instantiate(&ear, flex_the_model.guid);
  CHECK(set(c, LIMIT, 0.4) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);
  CHECK(set(c, FORCE, 1.0) == fmi2OK);

  // y = 1 - cos(t) passes the limit 0.4 at acos(0.6)
  CHECK(fmi2DoStep(c, 0.0, 2.0, fmi2True) == fmi2Discard);
  CHECK(strstr(ear.message, "no finite number") != NULL);
  double last;
  CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &last) == fmi2OK);
  CHECK_CLOSE(last, acos(0.6), 1e-5);
  CHECK_CLOSE(get(c, POSITION), 1.0 - cos(last), 1e-6);
  CHECK(fmi2DoStep(c, last, 0.5, fmi2True) == fmi2Discard);
  fmi2FreeInstance(c);

  // the same at the start
  c = instantiate(&ear, flex_the_model.guid);
  CHECK(set(c, LIMIT, -1.0) == fmi2OK && fmi2EnterInitializationMode(c) == fmi2OK);
  CHECK(fmi2ExitInitializationMode(c) == fmi2Error && strstr(ear.message, "no finite number") != NULL);
  CHECK(set(c, LIMIT, 1.0) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);
  fmi2FreeInstance(c);
}

// real-time importers cannot have a step wait for memory
void test_fmi_allocates_once(void) {
  importer ear;
  fmi2Component c = started(&ear, 0.3);
  double trace[50];
  drive(c, 0, 50, trace);
  CHECK(ear.n_allocations == 1);
  fmi2FreeInstance(c);
  CHECK(ear.n_live == 0);
}

// statistics on request, errors unless switched off, unknown categories refused; a % in a text is no format
void test_fmi_logs_what_is_asked_for(void) {
  importer ear;
  const fmi2String statistics[1] = {"statistics"}, unknown[1] = {"weather %s"}, errors[1] = {"logStatusError"};
  double trace[10];
  fmi2Component c = started(&ear, 0.3);
  drive(c, 0, 10, trace);
  CHECK(fmi2SetDebugLogging(c, fmi2True, 1, unknown) == fmi2Error);
  CHECK(strstr(ear.message, "'weather %s' is unknown") != NULL);
  CHECK(fmi2SetDebugLogging(c, fmi2True, 1, statistics) == fmi2OK);
  CHECK(fmi2Terminate(c) == fmi2OK);
  CHECK(strcmp(ear.category, "statistics") == 0 && strstr(ear.message, " steps, ") != NULL);
  int heard = ear.n_messages;
  CHECK(fmi2SetDebugLogging(c, fmi2False, 1, errors) == fmi2OK);
  CHECK(fmi2DoStep(c, 0.5, 0.1, fmi2True) == fmi2Error && ear.n_messages == heard);
  fmi2FreeInstance(c);
}

// outputs that are read after an input was set are the right-sided limits, position and rate going on
void test_fmi_inputs_jump_at_communication_points(void) {
  importer ear;
  fmi2Component c = started(&ear, 0.0);
  const fmi2ValueReference position = POSITION;
  const fmi2Integer order = 2;
  double left, right;
  CHECK(fmi2DoStep(c, 0.0, 0.5, fmi2True) == fmi2OK);
  CHECK(fmi2GetRealOutputDerivatives(c, &position, 1, &order, &left) == fmi2OK);
  CHECK(set(c, FORCE, 1.25) == fmi2OK);
  CHECK(fmi2GetRealOutputDerivatives(c, &position, 1, &order, &right) == fmi2OK);
  CHECK_CLOSE(left, 0.0, 1e-15);
  CHECK_CLOSE(right, 1.25, 1e-15);

  // derivatives go on over several steps until a new value is set
  CHECK(set(c, FORCE, 0.0) == fmi2OK && set_derivative(c, 1, 0.5) == fmi2OK);
  CHECK(fmi2DoStep(c, 0.5, 0.5, fmi2True) == fmi2OK && fmi2DoStep(c, 1.0, 0.5, fmi2True) == fmi2OK);
  CHECK_CLOSE(get(c, FORCE), 0.5, 1e-15);
  CHECK_CLOSE(get(c, POSITION), 0.5 * (1.0 - sin(1.0)), 1e-8);
  fmi2FreeInstance(c);
}

// times are start + n h: they must meet over a long run, also where the importer sums them up
void test_fmi_runs_a_hundred_thousand_steps(void) {
  importer ear;
  fmi2Component c = started(&ear, 0.5);
  CHECK(set(c, FORCE, 0.0) == fmi2OK);
  for (int k = 0; k < 50000; k++) CHECK(fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2True) == fmi2OK);
  double sum = 50.0, last;
  for (int k = 0; k < 50000; k++) {
    CHECK(fmi2DoStep(c, sum, 1e-3, fmi2True) == fmi2OK);
    sum += 1e-3;
  }
  CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &last) == fmi2OK);
  CHECK_CLOSE(last, 100.0, 1e-9);
  CHECK_CLOSE(get(c, POSITION), 0.5 * cos(100.0), 1e-7);
  fmi2FreeInstance(c);
}

// the importer integrates y'' + y = force + load; here with the classical Runge-Kutta method
void test_fmi_model_exchange(void) {
  importer ear;
  const double h = 0.01;
  double x[2], start[2], rate[4][2], last[2];
  fmi2Boolean event = fmi2True, end = fmi2True;
  fmi2EventInfo info;
  fmi2Component c = started_for(fmi2ModelExchange, &ear, 0.25);
  CHECK(fmi2NewDiscreteStates(c, &info) == fmi2OK && !info.newDiscreteStatesNeeded && !info.terminateSimulation);
  CHECK(!info.nominalsOfContinuousStatesChanged && !info.valuesOfContinuousStatesChanged && !info.nextEventTimeDefined);
  CHECK(set(c, FORCE, 0.0) == fmi2OK && set(c, LOAD, 0.5) == fmi2OK);
  CHECK(fmi2EnterContinuousTimeMode(c) == fmi2OK);
  CHECK(fmi2GetContinuousStates(c, x, 2) == fmi2OK && x[0] == 0.25 && x[1] == 0.0);
  for (int k = 0; k < 100; k++) {
    memcpy(start, x, sizeof x);
    for (int i = 0; i < 4; i++) {
      const double offset = i == 0 ? 0.0 : i == 3 ? h : 0.5 * h;
      for (int j = 0; i > 0 && j < 2; j++) x[j] = start[j] + offset * rate[i - 1][j];
      CHECK(fmi2SetTime(c, k * h + offset) == fmi2OK && fmi2SetContinuousStates(c, x, 2) == fmi2OK);
      CHECK(fmi2GetDerivatives(c, rate[i], 2) == fmi2OK);
    }
    for (int j = 0; j < 2; j++)
      x[j] = start[j] + h / 6.0 * (rate[0][j] + 2.0 * rate[1][j] + 2.0 * rate[2][j] + rate[3][j]);
    CHECK(fmi2SetTime(c, (k + 1) * h) == fmi2OK && fmi2SetContinuousStates(c, x, 2) == fmi2OK);
    CHECK(fmi2CompletedIntegratorStep(c, fmi2True, &event, &end) == fmi2OK && !event && !end);
  }
  CHECK_CLOSE(get(c, POSITION), 0.5 - 0.25 * cos(1.0), 1e-9);
  CHECK(fmi2GetContinuousStates(c, last, 2) == fmi2OK && memcmp(last, x, sizeof x) == 0);

  // parameters change at events, inputs at any time
  ear.n_messages = 0;
  CHECK(set(c, LOAD, 0.0) == fmi2Error && strstr(ear.message, "continuous-time mode") != NULL);
  CHECK(set(c, FORCE, 1.0) == fmi2OK && fmi2GetDerivatives(c, rate[0], 2) == fmi2OK);
  CHECK_CLOSE(rate[0][1], 1.5 - x[0], 1e-14);
  CHECK(fmi2EnterEventMode(c) == fmi2OK && set(c, LOAD, 0.0) == fmi2OK && fmi2Terminate(c) == fmi2OK);
  fmi2FreeInstance(c);
  CHECK(ear.n_live == 0);
}

// states beyond sense are refused, a point where the model fails is left by a smaller step, and nothing breaks for good
void test_fmi_model_exchange_is_checked(void) {
  importer ear;
  const double good[2] = {0.5, 0.0}, bad[2] = {0.0, NAN}, beyond[2] = {11.0, 0.0};
  double rate[2];
  fmi2Boolean event, end;
  fmi2Component c = started_for(fmi2ModelExchange, &ear, 0.0);
  CHECK(fmi2EnterContinuousTimeMode(c) == fmi2OK);
  CHECK(fmi2SetContinuousStates(c, bad, 2) == fmi2Error && strstr(ear.message, "state 1 must be finite") != NULL);
  CHECK(fmi2SetContinuousStates(c, good, 1) == fmi2Error && strstr(ear.message, "2 continuous states") != NULL);
  CHECK(fmi2SetTime(c, INFINITY) == fmi2Error && strstr(ear.message, "time must be finite") != NULL);
  CHECK(fmi2GetEventIndicators(c, rate, 1) == fmi2Error && strstr(ear.message, "event indicators") != NULL);

  // beyond `limit` the model gives no number
  CHECK(fmi2SetContinuousStates(c, beyond, 2) == fmi2OK);
  CHECK(fmi2GetDerivatives(c, rate, 2) == fmi2Discard && strstr(ear.message, "no finite number") != NULL);
  CHECK(fmi2CompletedIntegratorStep(c, fmi2True, &event, &end) == fmi2Error);

  // its margin is 2 - force, at least 0.5
  CHECK(fmi2SetContinuousStates(c, good, 2) == fmi2OK && set(c, FORCE, 1.75) == fmi2OK);
  CHECK(fmi2GetDerivatives(c, rate, 2) == fmi2Discard && strstr(ear.message, "keep away from the singularity") != NULL);
  CHECK(set(c, FORCE, 0.0) == fmi2OK && fmi2GetDerivatives(c, rate, 2) == fmi2OK && rate[1] == -0.5);
  CHECK(fmi2CompletedIntegratorStep(c, fmi2True, &event, &end) == fmi2OK);
  fmi2FreeInstance(c);
}

// a state of an instance that the importer integrates comes back with its mode; one of the other kind is refused
void test_fmi_model_exchange_states_are_restored(void) {
  importer ear, other_ear;
  const double x[2] = {0.5, 0.25}, elsewhere[2] = {-3.0, 1.0};
  double before[2], after[2];
  fmi2FMUstate state = NULL, foreign = NULL;
  fmi2Component other = started(&other_ear, 0.0);
  fmi2Component c = started_for(fmi2ModelExchange, &ear, 0.3);
  CHECK(fmi2EnterContinuousTimeMode(c) == fmi2OK && fmi2SetTime(c, 0.125) == fmi2OK);
  CHECK(fmi2SetContinuousStates(c, x, 2) == fmi2OK && fmi2GetDerivatives(c, before, 2) == fmi2OK);
  CHECK(fmi2GetFMUstate(c, &state) == fmi2OK);
  CHECK(fmi2SetContinuousStates(c, elsewhere, 2) == fmi2OK && set(c, FORCE, 1.0) == fmi2OK);
  CHECK(fmi2EnterEventMode(c) == fmi2OK && set(c, LOAD, 2.0) == fmi2OK);
  CHECK(fmi2SetFMUstate(c, state) == fmi2OK);
  CHECK(fmi2GetDerivatives(c, after, 2) == fmi2OK && memcmp(before, after, sizeof after) == 0);
  CHECK(fmi2NewDiscreteStates(c, NULL) == fmi2Error && strstr(ear.message, "continuous-time mode") != NULL);

  CHECK(fmi2GetFMUstate(other, &foreign) == fmi2OK);
  CHECK(fmi2SetFMUstate(c, foreign) == fmi2Error && strstr(ear.message, "co-simulation, this one") != NULL);
  CHECK(fmi2SetFMUstate(other, state) == fmi2Error);
  CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK && fmi2FreeFMUstate(other, &foreign) == fmi2OK);
  fmi2FreeInstance(c);
  fmi2FreeInstance(other);
}

// how the position changes with force, load and itself: in motion not by the force, at the start by the static equilibrium
void test_fmi_directional_derivatives(void) {
  importer ear;
  const fmi2ValueReference known[2] = {FORCE, LOAD}, position = POSITION, unknown[2] = {POSITION, FORCE};
  const double change[2] = {2.0, 0.5}, nothing = NAN;
  double result[2];
  fmi2Component c = instantiate(&ear, flex_the_model.guid);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, known, 2, change, result) == fmi2OK);
  CHECK_CLOSE(result[0], 2.5, 1e-15);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, &position, 1, change, result) == fmi2Error);
  CHECK(strstr(ear.message, "before the motion") != NULL);
  CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, known, 2, change, result) == fmi2OK && result[0] == 0.0);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, &position, 1, change, result) == fmi2OK && result[0] == 2.0);
  CHECK(fmi2GetDirectionalDerivative(c, unknown, 2, known, 2, change, result) == fmi2Error);
  CHECK(strstr(ear.message, "no output") != NULL);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, known, 1, &nothing, result) == fmi2Error);
  CHECK(strstr(ear.message, "must be finite") != NULL);
  fmi2FreeInstance(c);
}

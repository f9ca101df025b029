/* The FMI functions, called as an importer calls them. The model is `fragile`: y'' + y = force + load. */
#include "importer.h"
#include "models.h"
#include "tests.h"

enum { FORCE, LIMIT, LOAD, POSITION, FIXED_STEP };
enum { INITIAL, STEPS, INTEGRATOR = 6 };

// an instance that moves already, with a constant force
static fmi2Component started(fmi2Type type, importer *ear, double force) {
  fmi2Component c = instantiate(ear, type, "test", flex_the_model.guid, fmi2False);
  const fmi2ValueReference vr = FORCE;
  CHECK(c != NULL);
  CHECK(fmi2SetupExperiment(c, fmi2True, 1e-8, 0.0, fmi2False, 0.0) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
  CHECK(fmi2SetReal(c, &vr, 1, &force) == fmi2OK);
  CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
  return c;
}

static double get(fmi2Component c, fmi2ValueReference vr) {
  double value = NAN;
  CHECK(fmi2GetReal(c, &vr, 1, &value) == fmi2OK);
  return value;
}

static fmi2Status set(fmi2Component c, fmi2ValueReference vr, double value) {
  return fmi2SetReal(c, &vr, 1, &value);
}

static fmi2Status set_integer(fmi2Component c, fmi2ValueReference vr, int value) {
  return fmi2SetInteger(c, &vr, 1, &value);
}

static fmi2Status set_derivative(fmi2Component c, int order, double value) {
  const fmi2ValueReference vr = FORCE;
  return fmi2SetRealInputDerivatives(c, &vr, 1, &order, &value);
}

static double last_time(fmi2Component c) {
  double last = NAN;
  CHECK(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &last) == fmi2OK);
  return last;
}

// that a call was refused with these words
static void check_refusal(fmi2Status status, fmi2Status expected, const importer *ear, const char *words) {
  if (status != expected || !strstr(ear->message, words)) printf("%d, not %d: %s\n", status, expected, ear->message);
  CHECK(status == expected && strstr(ear->message, words) != NULL);
}

static int get_integer(fmi2Component c, fmi2ValueReference vr) {
  int value = -1;
  CHECK(fmi2GetInteger(c, &vr, 1, &value) == fmi2OK);
  return value;
}

// the way that every importer goes, and back to where it was; it is asked for memory once, so that no step waits for it
TEST(fmi_life_cycle) {
  importer ear;
  fmi2Component c = instantiate(&ear, fmi2CoSimulation, "test", flex_the_model.guid, fmi2False);
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
  CHECK(n_allocations == 1);
  CHECK_CLOSE(get(c, POSITION), 0.5 * cos(3.0), 1e-8);
  const fmi2ValueReference position[2] = {POSITION, POSITION}, force = FORCE;
  const fmi2Integer order[2] = {1, 2}, third = 3;
  double derivative[2];
  CHECK(fmi2GetRealOutputDerivatives(c, position, 2, order, derivative) == fmi2OK);
  CHECK_CLOSE(derivative[0], -0.5 * sin(3.0), 1e-8);
  CHECK_CLOSE(derivative[1], -0.5 * cos(3.0), 1e-8);
  CHECK_CLOSE(last_time(c), 8.0, 1e-14);
  CHECK(get_integer(c, STEPS) >= 30 && get_integer(c, STEPS + 1) >= 0);
  for (fmi2ValueReference statistic = STEPS + 2; statistic < STEPS + 5; statistic++) CHECK(get_integer(c, statistic) > 0);
  check_refusal(fmi2DoStep(c, 8.0, 1e-20, fmi2True), fmi2Error, &ear, "lost by rounding");
  check_refusal(fmi2GetRealOutputDerivatives(c, position, 1, &third, derivative), fmi2Error, &ear, "order 1 or 2, got order 3");
  CHECK(fmi2GetRealOutputDerivatives(c, &force, 1, order, derivative) == fmi2Error);
  CHECK(fmi2SetRealInputDerivatives(c, position, 1, order, derivative) == fmi2Error);

  // the same bits after a rollback, whatever came between; an existing state is reused
  fmi2FMUstate state = NULL, same;
  double ends[2];
  CHECK(fmi2GetFMUstate(c, &state) == fmi2OK && (same = state, fmi2GetFMUstate(c, &state) == fmi2OK) && state == same);
  for (int again = 0; again < 2; again++) {
    CHECK(fmi2SetFMUstate(c, state) == fmi2OK && set_derivative(c, 1, 0.5) == fmi2OK);
    for (int k = 0; k < 4; k++) CHECK(fmi2DoStep(c, 8.0 + k * 0.1, 0.1, fmi2False) == fmi2OK);
    ends[again] = get(c, POSITION);
  }
  CHECK(ends[0] == ends[1] && fmi2FreeFMUstate(c, &state) == fmi2OK && state == NULL);
  ear.n_messages = 0;
  CHECK(fmi2Terminate(c) == fmi2OK && get(c, POSITION) == ends[1]);
  fmi2FreeInstance(c);
  CHECK(n_live == 0 && ear.n_messages == 0);
}

// a binary of another version must not be run with this description; callbacks may be missing, instances too
TEST(fmi_instantiation_is_checked) {
  importer ear;
  CHECK(instantiate(&ear, fmi2CoSimulation, "test", "{somebody else}", fmi2False) == NULL && strstr(ear.message, "GUID") && n_live == 0);
  CHECK(instantiate(&ear, (fmi2Type)2, "test", flex_the_model.guid, fmi2False) == NULL && strstr(ear.message, "type"));
  CHECK(instantiate(&ear, fmi2CoSimulation, "", flex_the_model.guid, fmi2False) == NULL);
  CHECK(fmi2Instantiate("x", fmi2CoSimulation, flex_the_model.guid, NULL, NULL, fmi2False, fmi2True) == NULL);
  const fmi2CallbackFunctions bare = {NULL, NULL, NULL, NULL, NULL};
  fmi2Component c = fmi2Instantiate("x", fmi2CoSimulation, flex_the_model.guid, NULL, &bare, fmi2False, fmi2True);
  CHECK(c != NULL && fmi2DoStep(c, 0.0, 1.0, fmi2True) == fmi2Error);
  fmi2FreeInstance(c);
  CHECK(fmi2DoStep(NULL, 0.0, 1.0, fmi2True) == fmi2Error && fmi2Reset(NULL) == fmi2Error);
  fmi2FreeInstance(NULL);
}

// a refused value leaves the old one, and the sentence names variable, value, unit and range
TEST(fmi_values_are_checked) {
  importer ear;
  fmi2Component c = instantiate(&ear, fmi2CoSimulation, "test", flex_the_model.guid, fmi2False);
  const struct {
    fmi2ValueReference vr;
    double value;
    const char *words;
  } reals[] = {{FORCE, NAN, "force must be a finite number in N, got"},
               {FORCE, 101.0, "force must be in -100 .. 100 N, got 101"},
               {LOAD, -5.5, "load must be in -5 .. 5 N, got -5.5"},
               {POSITION, 0.0, "position is an output"},
               {FIXED_STEP, -1e-3, "integrator.step must be in 0 .. inf s, got -0.001"},
               {FIXED_STEP + 1, 0.0, "value reference 5"}};
  for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
    check_refusal(set(c, reals[i].vr, reals[i].value), fmi2Error, &ear, reals[i].words);
  CHECK(set(c, FIXED_STEP, 1e-3) == fmi2OK && get(c, FIXED_STEP) == 1e-3);
  double value;
  const fmi2ValueReference position = POSITION;
  check_refusal(fmi2GetReal(c, &position, 1, &value), fmi2Error, &ear, "before fmi2EnterInitializationMode");
  check_refusal(set_derivative(c, 4, 0.0), fmi2Error, &ear, "order 1 to 3, got order 4");
  CHECK(set_derivative(c, 0, 0.0) == fmi2Error);
  CHECK(get(c, FORCE) == 0.0 && get(c, LOAD) == 0.0);
  check_refusal(set_integer(c, INITIAL, 3), fmi2Error, &ear, "1 (static) or 2 (undeformed), got 3");
  check_refusal(set_integer(c, INTEGRATOR, 9), fmi2Error, &ear, "integrator must be 1 (automatic), 2");
  CHECK(set_integer(c, STEPS, 2) == fmi2Error);
  CHECK(set_integer(c, INTEGRATOR, 2) == fmi2OK && get_integer(c, INTEGRATOR) == 2);
  CHECK(set_integer(c, INITIAL, 2) == fmi2OK && get_integer(c, INITIAL) == 2);
  fmi2FreeInstance(c);
}

// near a singularity the step is discarded with the reason, the plant stays at the last good time and can go on
TEST(fmi_singularity_discards_the_step) {
  importer ear;
  fmi2Component c = started(fmi2CoSimulation, &ear, 0.0);
  CHECK(set_derivative(c, 1, 1.0) == fmi2OK);
  CHECK(fmi2DoStep(c, 0.0, 1.0, fmi2True) == fmi2OK);

  // the margin 2 - t reaches 0.5 at t = 1.5
  check_refusal(fmi2DoStep(c, 1.0, 1.0, fmi2True), fmi2Discard, &ear, "distance between the elbows (m) is 0.");
  CHECK(ear.n_heard[LOG_DISCARD] == 1);
  double last = last_time(c), position = get(c, POSITION);
  CHECK_CLOSE(last, 1.5, 1e-6);
  CHECK_CLOSE(position, last - sin(last), 1e-8);

  // with another force it goes on from there
  CHECK(set(c, FORCE, 1.0) == fmi2OK && get(c, POSITION) == position);
  CHECK(fmi2DoStep(c, last, 0.5, fmi2True) == fmi2OK && isfinite(get(c, POSITION)));
  fmi2FreeInstance(c);
}

// NaN from the model never reaches an output
TEST(fmi_nan_discards_the_step) {
  importer ear;
  fmi2Component c = instantiate(&ear, fmi2CoSimulation, "test", flex_the_model.guid, fmi2False);
  CHECK(set(c, LIMIT, -1.0) == fmi2OK && fmi2EnterInitializationMode(c) == fmi2OK);
  check_refusal(fmi2ExitInitializationMode(c), fmi2Error, &ear, "no finite number");
  CHECK(set(c, LIMIT, 0.4) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);

  // y = 1 - cos(t) passes the limit 0.4 at acos(0.6)
  CHECK(set(c, FORCE, 1.0) == fmi2OK);
  check_refusal(fmi2DoStep(c, 0.0, 2.0, fmi2True), fmi2Discard, &ear, "no finite number");
  CHECK_CLOSE(last_time(c), acos(0.6), 1e-5);
  CHECK_CLOSE(get(c, POSITION), 1.0 - cos(last_time(c)), 1e-6);
  CHECK(fmi2DoStep(c, last_time(c), 0.5, fmi2True) == fmi2Discard);
  fmi2FreeInstance(c);
}

// statistics on request, errors unless switched off, unknown categories refused; a % in a text is no format
TEST(fmi_logs_what_is_asked_for) {
  importer ear;
  const fmi2String statistics[1] = {"statistics"}, unknown[1] = {"weather %s"}, errors[1] = {"logStatusError"};
  fmi2Component c = started(fmi2CoSimulation, &ear, 0.3);
  CHECK(fmi2DoStep(c, 0.0, 0.5, fmi2True) == fmi2OK);
  check_refusal(fmi2SetDebugLogging(c, fmi2True, 1, unknown), fmi2Error, &ear, "'weather %s' is unknown");
  CHECK(fmi2SetDebugLogging(c, fmi2True, 1, statistics) == fmi2OK && fmi2Terminate(c) == fmi2OK);
  CHECK(ear.n_heard[LOG_STATISTICS] == 1 && strstr(ear.message, " steps, ") != NULL);
  int heard = ear.n_messages;
  CHECK(fmi2SetDebugLogging(c, fmi2False, 1, errors) == fmi2OK);
  CHECK(fmi2DoStep(c, 0.5, 0.1, fmi2True) == fmi2Error && ear.n_messages == heard);
  fmi2FreeInstance(c);
}

// times are start + n h: they must meet over a long run, also where the importer sums them up
TEST(fmi_runs_a_hundred_thousand_steps) {
  importer ear;
  fmi2Component c = started(fmi2CoSimulation, &ear, 0.5);
  CHECK(set(c, FORCE, 0.0) == fmi2OK);
  for (int k = 0; k < 50000; k++) CHECK(fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2True) == fmi2OK);
  double sum = 50.0;
  for (int k = 0; k < 50000; k++) {
    CHECK(fmi2DoStep(c, sum, 1e-3, fmi2True) == fmi2OK);
    sum += 1e-3;
  }
  CHECK_CLOSE(last_time(c), 100.0, 1e-9);
  CHECK_CLOSE(get(c, POSITION), 0.5 * cos(100.0), 1e-7);
  fmi2FreeInstance(c);
}

// the importer integrates y'' + y = force + load; here with the classical Runge-Kutta method
TEST(fmi_model_exchange) {
  importer ear;
  const double h = 0.01;
  double x[2], start[2], rate[4][2], last[2];
  fmi2Boolean event = fmi2True, end = fmi2True;
  fmi2EventInfo info;
  fmi2Component c = started(fmi2ModelExchange, &ear, 0.25);
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
  CHECK(n_live == 0);
}

// states beyond sense are refused, a point where the model fails is left by a smaller step, and nothing breaks for good
TEST(fmi_model_exchange_is_checked) {
  importer ear, other_ear;
  const double good[2] = {0.5, 0.0}, bad[2] = {0.0, NAN}, beyond[2] = {11.0, 0.0};
  double rate[2];
  fmi2Boolean event, end;
  fmi2Component c = started(fmi2ModelExchange, &ear, 0.0);
  CHECK(fmi2EnterContinuousTimeMode(c) == fmi2OK);
  check_refusal(fmi2SetContinuousStates(c, bad, 2), fmi2Error, &ear, "state 1 must be finite");
  check_refusal(fmi2SetContinuousStates(c, good, 1), fmi2Error, &ear, "2 continuous states");
  check_refusal(fmi2SetTime(c, INFINITY), fmi2Error, &ear, "time must be finite");
  check_refusal(fmi2GetEventIndicators(c, rate, 1), fmi2Error, &ear, "event indicators");
  check_refusal(fmi2NewDiscreteStates(c, NULL), fmi2Error, &ear, "continuous-time mode");

  // beyond `limit` the model gives no number; its margin is 2 - force, at least 0.5
  CHECK(fmi2SetContinuousStates(c, beyond, 2) == fmi2OK);
  check_refusal(fmi2GetDerivatives(c, rate, 2), fmi2Discard, &ear, "no finite number");
  CHECK(fmi2CompletedIntegratorStep(c, fmi2True, &event, &end) == fmi2Error);
  CHECK(fmi2SetContinuousStates(c, good, 2) == fmi2OK && set(c, FORCE, 1.75) == fmi2OK);
  check_refusal(fmi2GetDerivatives(c, rate, 2), fmi2Discard, &ear, "keep away from the singularity");
  CHECK(set(c, FORCE, 0.0) == fmi2OK && fmi2GetDerivatives(c, rate, 2) == fmi2OK && rate[1] == -0.5);
  CHECK(fmi2CompletedIntegratorStep(c, fmi2True, &event, &end) == fmi2OK);

  // a saved state comes back with its mode; one of an instance of the other kind is refused
  fmi2FMUstate state = NULL, foreign = NULL;
  fmi2Component other = started(fmi2CoSimulation, &other_ear, 0.0);
  CHECK(fmi2GetFMUstate(c, &state) == fmi2OK && fmi2GetFMUstate(other, &foreign) == fmi2OK);
  CHECK(fmi2SetContinuousStates(c, beyond, 2) == fmi2OK && set(c, FORCE, 1.0) == fmi2OK);
  CHECK(fmi2EnterEventMode(c) == fmi2OK && set(c, LOAD, 2.0) == fmi2OK);
  CHECK(fmi2SetFMUstate(c, state) == fmi2OK && fmi2GetDerivatives(c, rate, 2) == fmi2OK && rate[1] == -0.5);
  CHECK(fmi2SetTime(c, 0.125) == fmi2OK);
  check_refusal(fmi2SetFMUstate(c, foreign), fmi2Error, &ear, "co-simulation, this one");
  CHECK(fmi2SetFMUstate(other, state) == fmi2Error);
  CHECK(fmi2FreeFMUstate(c, &state) == fmi2OK && fmi2FreeFMUstate(other, &foreign) == fmi2OK);
  fmi2FreeInstance(c);
  fmi2FreeInstance(other);
}

// how the position changes with force, load and itself: in motion not by the force, at the start by the static equilibrium
TEST(fmi_directional_derivatives) {
  importer ear;
  const fmi2ValueReference known[2] = {FORCE, LOAD}, position = POSITION, unknown[2] = {POSITION, FORCE};
  const double change[2] = {2.0, 0.5}, nothing = NAN;
  double result[2];
  fmi2Component c = instantiate(&ear, fmi2CoSimulation, "test", flex_the_model.guid, fmi2False);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, known, 2, change, result) == fmi2OK);
  CHECK_CLOSE(result[0], 2.5, 1e-15);
  check_refusal(fmi2GetDirectionalDerivative(c, &position, 1, &position, 1, change, result), fmi2Error, &ear, "before the motion");
  CHECK(fmi2ExitInitializationMode(c) == fmi2OK);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, known, 2, change, result) == fmi2OK && result[0] == 0.0);
  CHECK(fmi2GetDirectionalDerivative(c, &position, 1, &position, 1, change, result) == fmi2OK && result[0] == 2.0);
  check_refusal(fmi2GetDirectionalDerivative(c, unknown, 2, known, 2, change, result), fmi2Error, &ear, "no output");
  check_refusal(fmi2GetDirectionalDerivative(c, &position, 1, known, 1, &nothing, result), fmi2Error, &ear, "must be finite");
  fmi2FreeInstance(c);
}

/* Sequences of FMI calls, as the bytes of a fuzzer decide: each is judged call by call (fuzzed_calls.c), may be repeated from
 * a saved state, in this instance or another one, and ends with a run that must equal that of a new instance.
 *
 * fuzz_main.c draws the bytes; clang's libFuzzer finds better ones: leave that file out and add -fsanitize=fuzzer. */
#include <math.h>
#include <string.h>

#include "fuzzed_calls.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { REFERENCE_STEPS = 4 };

// a state of one instance in another one, by way of bytes
static void hand_over(fuzzed *from, fmi2FMUstate state, fuzzed *to) {
  size_t size = 0;
  fmi2FMUstate copy = NULL;
  CHECK(fmi2SerializedFMUstateSize(from->component, state, &size) == fmi2OK);
  fmi2Byte *bytes = malloc(size);
  CHECK(bytes != NULL && fmi2SerializeFMUstate(from->component, state, bytes, size) == fmi2OK);
  CHECK(fmi2DeSerializeFMUstate(to->component, bytes, size, &copy) == fmi2OK);
  CHECK(fmi2SetFMUstate(to->component, copy) == fmi2OK && fmi2FreeFMUstate(to->component, &copy) == fmi2OK);
  free(bytes);
}

// the same calls after a rollback return the same bits
static void replay(fuzzed *one, tape *tape) {
  importer_doing = "rolling back";
  unsigned choice = tape_byte(tape);
  size_t begin = tape->at;
  expectation now = one->now;
  fmi2FMUstate state = NULL;
  CHECK(fmi2GetFMUstate(one->component, &state) == fmi2OK);
  one->trace = 0;
  for (unsigned i = 0; i < 1 + choice % 8; i++) fuzzed_call(one, tape, 1);
  uint64_t first = one->trace;

  // again, here or elsewhere
  importer ear;
  fuzzed other, *again = one;
  if (choice & 64) {
    fuzzed_begin(&other, &ear, one->type, fmi2True);
    memcpy(other.shown, one->shown, sizeof other.shown);
    for (int i = 0; i < N_LOG_CATEGORIES; i++)
      CHECK(fmi2SetDebugLogging(other.component, one->shown[i], 1, &flex_log_categories[i]) == fmi2OK);
    hand_over(one, state, &other);
    again = &other;
  } else {
    CHECK(fmi2SetFMUstate(one->component, state) == fmi2OK);
  }
  again->now = now;
  again->trace = 0;
  tape->at = begin;
  for (unsigned i = 0; i < 1 + choice % 8; i++) fuzzed_call(again, tape, 1);
  importer_doing = "replaying";
  CHECK(again->trace == first);
  CHECK(fmi2FreeFMUstate(one->component, &state) == fmi2OK);
  if (again == &other) fuzzed_end(&other);
}

// beyond the stop times of fuzzed_calls.c
static void reference_steps(fuzzed *one) {
  fmi2Component c = one->component;
  const fmi2ValueReference input = 0;
  const fmi2Integer order = 1;
  const double rate = 0.25;
  fmi2Status last = fmi2Fatal;
  CHECK(fmi2GetStatus(c, fmi2DoStepStatus, &last) == fmi2OK && last == fmi2OK);
  for (int k = 0; k < REFERENCE_STEPS; k++) {
    if (N_INPUTS > 0 && k == 1) CHECK(fmi2SetRealInputDerivatives(c, &input, 1, &order, &rate) == fmi2OK);
    CHECK(fmi2DoStep(c, 2e-3 * k, 2e-3, fmi2True) == fmi2OK);
    for (fmi2ValueReference vr = N_SETTABLE; vr < N_REALS; vr++) {
      double value = NAN;
      CHECK(fmi2GetReal(c, &vr, 1, &value) == fmi2OK && isfinite(value));
      fuzzed_note(one, &value, sizeof value);
    }
  }
}

#ifdef N_STATES
// explicit Euler steps
static void reference_integration(fuzzed *one) {
  fmi2Component c = one->component;
  fmi2EventInfo info;
  double x[N_STATES], rates[N_STATES];
  CHECK(fmi2NewDiscreteStates(c, &info) == fmi2OK && fmi2EnterContinuousTimeMode(c) == fmi2OK);
  for (int k = 0; k < REFERENCE_STEPS; k++) {
    CHECK(fmi2SetTime(c, 1e-5 * k) == fmi2OK);
    CHECK(fmi2GetContinuousStates(c, x, N_STATES) == fmi2OK && fmi2GetDerivatives(c, rates, N_STATES) == fmi2OK);
    for (int i = 0; i < N_STATES; i++) x[i] += 1e-5 * (rates[i] + 0.1);
    CHECK(fmi2SetContinuousStates(c, x, N_STATES) == fmi2OK);
    fuzzed_note(one, rates, sizeof rates);
  }
}
#endif

// hash of a plain run without fmi2SetupExperiment; the instance must be in the state "instantiated"
static uint64_t reference_run(fuzzed *one) {
  importer_doing = "making the reference run";
  one->trace = 0;
  CHECK(fmi2EnterInitializationMode(one->component) == fmi2OK && fmi2ExitInitializationMode(one->component) == fmi2OK);
#ifdef N_STATES
  if (one->type == fmi2ModelExchange) {
    reference_integration(one);
    return one->trace;
  }
#endif
  reference_steps(one);
  return one->trace;
}

static uint64_t run_of_a_new_instance(fmi2Type type) {
  importer ear;
  fuzzed fresh;
  fuzzed_begin(&fresh, &ear, type, fmi2False);
  uint64_t trace = reference_run(&fresh);
  fuzzed_end(&fresh);
  return trace;
}

// no memory at all, wrong GUID: no instance, but a sentence
static void begin_badly(unsigned choice) {
  importer ear;
  importer_doing = "instantiating";
  if (choice & 2) importer_runs_out_of_memory();
  CHECK(importer_instantiate(&ear, fmi2CoSimulation, choice & 2 ? GUID : "{somebody else}", fmi2False) == NULL);
  CHECK(ear.n_heard[LOG_ERROR] == 1 && ear.status == fmi2Error);
}

static void to_the_first_step(fuzzed *one) {
  fmi2Component c = one->component;
  CHECK(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);
  one->now.phase = one->type == fmi2CoSimulation ? STEP_COMPLETE : EVENT_MODE;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  tape tape = {data, size, 0};
  importer ear;
  fuzzed one;
  unsigned choice = tape_byte(&tape);
  if (choice % 64 == 1) begin_badly(choice / 64);
#ifdef N_STATES
  fmi2Type type = choice & 128 ? fmi2ModelExchange : fmi2CoSimulation;
#else
  fmi2Type type = fmi2CoSimulation;
#endif
  fuzzed_begin(&one, &ear, type, choice & 4);
  if (choice & 8) to_the_first_step(&one);
  while (tape.at < tape.size)
    if (tape_byte(&tape) % 16 == 0)
      replay(&one, &tape);
    else
      fuzzed_call(&one, &tape, 0);

  // whatever it went through, a reset instance is a new one
  if (choice & 48) {
    static uint64_t references[2];
    uint64_t *reference = references + (type == fmi2ModelExchange);
    if (!*reference) *reference = run_of_a_new_instance(type);
    CHECK(fmi2Reset(one.component) == fmi2OK);
    CHECK(reference_run(&one) == *reference);
  }
  fuzzed_end(&one);
  CHECK(importer_live() == 0);
  return 0;
}

/* Sequences of FMI calls, as the bytes of a fuzzer decide: each is judged call by call by what the standard and the FMU promise,
 * may be repeated from a saved state, in this instance or another one, and ends with a run that must equal that of a new instance.
 *
 * The build defines what is fuzzed: GUID, N_INPUTS, N_SETTABLE, N_REALS, N_INTEGERS, and N_STATES and N_INDICATORS if there is
 * model exchange. FUZZ_TRACE=1 in the environment shows all calls. The bytes are drawn; clang's libFuzzer finds better ones:
 * -DLIBFUZZER -fsanitize=fuzzer. */
#define _POSIX_C_SOURCE 200112L

#include <float.h>
#include <stdint.h>
#include <unistd.h>

#include "importer.h"

enum { N_SLOTS = 3, MOST_VALUES = 4, REFERENCE_STEPS = 4 };

/* bytes that decide what is called with which arguments; behind their end there are zeros */
typedef struct {
  const uint8_t *bytes;
  size_t size, at;
} tape;

static unsigned tape_byte(tape *tape) {
  return tape->at < tape->size ? tape->bytes[tape->at++] : (tape->at++, 0);
}

// a number: mostly between -0.5 and 0.5, else one of those that programmers forget
static double tape_real(tape *tape) {
  static const double forgotten[] = {0.0,  -0.0,   NAN,   INFINITY, -INFINITY, DBL_MAX, -DBL_MAX, DBL_MIN,
                                     5e-324, 1e-20, 1e300, 1e18,     -1.0,      1.0,     2.0,      1e4};
  unsigned choice = tape_byte(tape);
  return choice < 208 ? ((double)choice - 104.0) / 208.0 : forgotten[choice % 16];
}

// one of 0 .. count - 1 mostly, else beyond
static unsigned tape_index(tape *tape, unsigned count) {
  static const unsigned beyond[] = {0, 1, 1000000, 0x7fffffff, 0x80000000, 0xffffffff};
  unsigned choice = tape_byte(tape);
  if (choice < 240 && count > 0) return choice % count;
  return choice % 6 < 2 ? count + beyond[choice % 6] : beyond[choice % 6];
}

/* where an instance must be after the calls so far */
typedef struct {
  flex_phase phase;
  double time;
} expectation;

typedef struct {
  fmi2Component component;
  importer *ear;
  fmi2Type type;
  expectation now;
  int shown[N_LOG_CATEGORIES];
  int before[N_LOG_CATEGORIES]; /* messages heard before the present call */
  uint64_t trace;               /* hash of all that the calls have returned */
  fmi2FMUstate slots[N_SLOTS];
  expectation saved[N_SLOTS];
} fuzzed;

static const struct {
  const char *name;
  int kinds, phases;
} calls[] = {
#define X(function, kinds, phases) {#function, kinds, phases},
    FLEX_FMI2_CALLS(X)
#undef X
};

#define N_CALLS (sizeof calls / sizeof *calls)

// adds to the trace
static void fuzzed_note(fuzzed *one, const void *bytes, size_t size) {
  const unsigned char *byte = bytes;
  for (size_t i = 0; i < size; i++) one->trace = (one->trace ^ byte[i]) * 1099511628211ULL;
}

// a new instance in the state "instantiated"
static void fuzzed_begin(fuzzed *one, importer *ear, fmi2Type type, fmi2Boolean logging) {
  memset(one, 0, sizeof *one);
  one->ear = ear;
  one->type = type;
  one->component = instantiate(ear, type, "fuzzed", GUID, logging);
  CHECK(one->component != NULL);
  one->now.phase = INSTANTIATED;
  for (int i = 0; i < N_LOG_CATEGORIES; i++) one->shown[i] = logging || i != LOG_STATISTICS;
}

static int may_discard(flex_call_id call) {
  return call == call_fmi2DoStep || call == call_fmi2GetStatus || call == call_fmi2GetRealStatus ||
         call == call_fmi2GetIntegerStatus || call == call_fmi2GetBooleanStatus || call == call_fmi2GetStringStatus ||
         call == call_fmi2GetDerivatives || call == call_fmi2GetEventIndicators;
}

static int heard(const fuzzed *one, flex_log_category category) {
  return one->ear->n_heard[category] - one->before[category];
}

// checks the status of a call against the state, what is logged and what the function may return
static void fuzzed_judge(fuzzed *one, flex_call_id call, fmi2Status status) {
  if (getenv("FUZZ_TRACE")) fprintf(stderr, "%s -> %d  %s\n", calls[call].name, (int)status, one->ear->message);
  fuzzed_note(one, &status, sizeof status);
  int kind = one->type == fmi2CoSimulation ? STEPPING : EXCHANGE;
  int is_legal = (calls[call].kinds & kind) && (calls[call].phases & (int)one->now.phase);
  CHECK(is_legal || status == fmi2Error);
  CHECK(status == fmi2OK || status == fmi2Warning || status == fmi2Discard || status == fmi2Error);
  CHECK(status != fmi2Warning || call == call_fmi2SetupExperiment);
  CHECK(status != fmi2Discard || may_discard(call));

  // whatever is refused has a sentence, whatever is served has none
  CHECK(heard(one, LOG_ERROR) == (status == fmi2Error && one->shown[LOG_ERROR]));
  CHECK(heard(one, LOG_DISCARD) == (status == fmi2Discard && one->shown[LOG_DISCARD]));
  CHECK(heard(one, LOG_WARNING) == (status == fmi2Warning && one->shown[LOG_WARNING]));
  CHECK(heard(one, LOG_FATAL) == 0);
  if (status != fmi2OK && one->shown[LOG_ERROR] && one->shown[LOG_DISCARD] && one->shown[LOG_WARNING])
    CHECK(one->ear->status == status);
  if (!is_legal && one->shown[LOG_ERROR]) CHECK(strstr(one->ear->message, calls[call].name) != NULL);
  if (is_legal && heard(one, LOG_ERROR)) CHECK(strstr(one->ear->message, "must not be called in the state") == NULL);
}

// what was read is a number, wherever the FMU says that it is fine
static void note_reals(fuzzed *one, fmi2Status status, const double *values, size_t count) {
  if (status != fmi2OK) return;
  for (size_t i = 0; i < count; i++) CHECK(isfinite(values[i]));
  fuzzed_note(one, values, count * sizeof *values);
}

// arrays as an importer hands them over; now and then one of them is missing
typedef struct {
  size_t count;
  fmi2ValueReference references[MOST_VALUES];
  double reals[MOST_VALUES];
  int integers[MOST_VALUES], orders[MOST_VALUES];
  int lacks_references, lacks_values, lacks_orders;
} arrays;

static arrays read_arrays(tape *tape, unsigned n_references) {
  arrays a;
  memset(&a, 0, sizeof a);
  unsigned shape = tape_byte(tape);
  a.count = shape % (MOST_VALUES + 1);
  if (shape > 240) a.lacks_references = shape & 1, a.lacks_values = shape & 2, a.lacks_orders = shape & 4;
  for (size_t i = 0; i < a.count; i++) {
    a.references[i] = tape_index(tape, n_references);
    a.reals[i] = tape_real(tape);
    a.integers[i] = (int)(tape_byte(tape) % 10) - 1;
    a.orders[i] = (int)(tape_byte(tape) % 6) - 1;
  }
  return a;
}

static void serve_values(fuzzed *one, tape *tape, flex_call_id call) {
  fmi2Component c = one->component;
  int is_setter = call == call_fmi2SetReal || call == call_fmi2SetRealInputDerivatives;
  int is_integer = call == call_fmi2GetInteger || call == call_fmi2SetInteger;
  arrays a = read_arrays(tape, is_integer ? N_INTEGERS : is_setter && tape_byte(tape) % 4 ? N_SETTABLE : N_REALS);
  const fmi2ValueReference *vr = a.lacks_references ? NULL : a.references;
  double *reals = a.lacks_values ? NULL : a.reals;
  int *integers = a.lacks_values ? NULL : a.integers, *orders = a.lacks_orders ? NULL : a.orders;
  fmi2String texts[MOST_VALUES] = {"", "a", NULL, "b"};
  fmi2Status status = fmi2Fatal;
  int reads_reals = 0;
  switch (call) {
    case call_fmi2GetReal: status = fmi2GetReal(c, vr, a.count, reals), reads_reals = 1; break;
    case call_fmi2SetReal: status = fmi2SetReal(c, vr, a.count, reals); break;
    case call_fmi2GetInteger: status = fmi2GetInteger(c, vr, a.count, integers); break;
    case call_fmi2SetInteger: status = fmi2SetInteger(c, vr, a.count, integers); break;
    case call_fmi2GetBoolean: status = fmi2GetBoolean(c, vr, a.count, integers); break;
    case call_fmi2SetBoolean: status = fmi2SetBoolean(c, vr, a.count, integers); break;
    case call_fmi2GetString: status = fmi2GetString(c, vr, a.count, texts); break;
    case call_fmi2SetString: status = fmi2SetString(c, vr, a.count, texts); break;
    case call_fmi2SetRealInputDerivatives: status = fmi2SetRealInputDerivatives(c, vr, a.count, orders, reals); break;
    case call_fmi2GetRealOutputDerivatives:
      status = fmi2GetRealOutputDerivatives(c, vr, a.count, orders, reals), reads_reals = 1;
      break;
    default: CHECK(!"a call that concerns values");
  }
  fuzzed_judge(one, call, status);
  CHECK(status == fmi2Error || a.count == 0 || (!a.lacks_references && !a.lacks_values));
  if (reads_reals) note_reals(one, status, a.reals, a.count);
  if (call == call_fmi2GetInteger && status == fmi2OK) fuzzed_note(one, a.integers, a.count * sizeof *a.integers);
}

static void serve_derivative(fuzzed *one, tape *tape) {
  arrays unknown = read_arrays(tape, N_REALS), known = read_arrays(tape, N_REALS);
  fmi2Status status = fmi2GetDirectionalDerivative(
      one->component, unknown.lacks_references ? NULL : unknown.references, unknown.count,
      known.lacks_references ? NULL : known.references, known.count, known.lacks_values ? NULL : known.reals,
      unknown.lacks_values ? NULL : unknown.reals);
  fuzzed_judge(one, call_fmi2GetDirectionalDerivative, status);
  note_reals(one, status, unknown.reals, unknown.count);
}

static void serve_logging(fuzzed *one, tape *tape) {
  unsigned choice = tape_byte(tape);
  size_t count = choice % 3;
  int on = (choice & 8) != 0;
  fmi2String categories[2] = {"weather", NULL};
  int known[2] = {0, 0};
  for (size_t i = 0; i < 2; i++) {
    unsigned which = tape_byte(tape) % 8;
    known[i] = which < N_LOG_CATEGORIES;
    if (known[i]) categories[i] = flex_log_categories[which];
  }
  fmi2Status status = fmi2SetDebugLogging(one->component, on, count, choice > 250 ? NULL : categories);
  fuzzed_judge(one, call_fmi2SetDebugLogging, status);
  CHECK(choice > 250 || (status == fmi2OK) == ((count < 1 || known[0]) && (count < 2 || known[1])));
  if (status != fmi2OK) return;
  for (int i = 0; i < N_LOG_CATEGORIES; i++) {
    int is_meant = count == 0;
    for (size_t k = 0; k < count; k++) is_meant |= strcmp(categories[k], flex_log_categories[i]) == 0;
    if (is_meant) one->shown[i] = on;
  }
}

static void serve_setup(fuzzed *one, tape *tape) {
  unsigned choice = tape_byte(tape);
  int is_plain = choice % 4 != 0;
  double tolerance = is_plain ? 1e-6 : fabs(tape_real(tape)), start = is_plain ? 0.0 : tape_real(tape);
  double stop = choice & 16 ? 0.006 : tape_real(tape);
  fmi2Status status = fmi2SetupExperiment(one->component, choice & 32, tolerance, start, (choice & 64) != 0, stop);
  fuzzed_judge(one, call_fmi2SetupExperiment, status);
  if (status <= fmi2Warning) one->now.time = start;
}

// the steps of an importer with a varying step size, and those of a confused one
static void serve_step(fuzzed *one, tape *tape) {
  unsigned choice = tape_byte(tape);
  double point = choice % 16 == 0 ? tape_real(tape) : one->now.time;
  double step = choice % 16 == 1 ? tape_real(tape) : 1e-4 * (1.0 + tape_byte(tape)) * (choice & 64 ? 10.0 : 1.0);
  fmi2Status status = fmi2DoStep(one->component, point, step, choice & 128);
  fuzzed_judge(one, call_fmi2DoStep, status);
  if (status == fmi2Error) return;
  CHECK(isfinite(point) && isfinite(step) && step > 0.0);

  // the FMU is where the step ends, or where it got to
  double last = NAN, end = point + step;
  CHECK(fmi2GetRealStatus(one->component, fmi2LastSuccessfulTime, &last) == fmi2OK);
  CHECK(status == fmi2OK ? last == end : last >= point && last <= end);
  one->now.time = last;
  one->now.phase = status == fmi2OK ? STEP_COMPLETE : STEP_FAILED;
  note_reals(one, fmi2OK, &last, 1);
}

static void serve_status(fuzzed *one, tape *tape, flex_call_id call) {
  fmi2Component c = one->component;
  unsigned choice = tape_byte(tape);
  int is_lacking = choice > 240, number = 0;
  fmi2StatusKind kind = (fmi2StatusKind)(choice % 4);
  fmi2Status status = fmi2Fatal, last = fmi2Fatal;
  double time = NAN;
  fmi2String text = NULL;
  if (call == call_fmi2GetStatus) status = fmi2GetStatus(c, kind, is_lacking ? NULL : &last);
  if (call == call_fmi2GetRealStatus) status = fmi2GetRealStatus(c, kind, is_lacking ? NULL : &time);
  if (call == call_fmi2GetIntegerStatus) status = fmi2GetIntegerStatus(c, kind, is_lacking ? NULL : &number);
  if (call == call_fmi2GetBooleanStatus) status = fmi2GetBooleanStatus(c, kind, is_lacking ? NULL : &number);
  if (call == call_fmi2GetStringStatus) status = fmi2GetStringStatus(c, kind, is_lacking ? NULL : &text);
  fuzzed_judge(one, call, status);
  if (status != fmi2OK) return;
  CHECK(!is_lacking);
  if (call == call_fmi2GetRealStatus) CHECK(time == one->now.time);
  if (call == call_fmi2GetStatus && one->now.phase == STEP_FAILED) CHECK(last == fmi2Discard);
  if (call == call_fmi2GetStringStatus) CHECK(text != NULL && strlen(text) > 10);
}

static void serve_mode(fuzzed *one, flex_call_id call) {
  fmi2Component c = one->component;
  fmi2Status status = fmi2Fatal;
  flex_phase next = one->now.phase;
  switch (call) {
    case call_fmi2EnterInitializationMode: status = fmi2EnterInitializationMode(c), next = INITIALISATION_MODE; break;
    case call_fmi2ExitInitializationMode:
      status = fmi2ExitInitializationMode(c), next = one->type == fmi2CoSimulation ? STEP_COMPLETE : EVENT_MODE;
      break;
    case call_fmi2Terminate: status = fmi2Terminate(c), next = TERMINATED; break;
    case call_fmi2Reset: status = fmi2Reset(c), next = INSTANTIATED; break;
    case call_fmi2CancelStep: status = fmi2CancelStep(c); break;
    default: CHECK(!"a call that changes the mode");
  }
  fuzzed_judge(one, call, status);
  if (status == fmi2OK) one->now.phase = next;
  if (call == call_fmi2Reset) one->now.time = 0.0;
}

#ifdef N_STATES
enum { MOST_STATES = N_STATES + 3 };

// what an integrator of the importer does; arrays may be missing or have another size
static void serve_exchange(fuzzed *one, tape *tape, flex_call_id call) {
  fmi2Component c = one->component;
  unsigned choice = tape_byte(tape);
  double x[MOST_STATES], time = choice & 16 ? one->now.time + 1e-4 * tape_byte(tape) : tape_real(tape);
  for (int i = 0; i < MOST_STATES; i++) x[i] = (choice & 32 ? 1e-3 : 1.0) * tape_real(tape);
  size_t size = choice % 16 ? N_STATES : tape_byte(tape) % (MOST_STATES + 1);
  int is_lacking = choice > 248, reads = 0;
  double *states = is_lacking ? NULL : x;
  fmi2EventInfo info = {9, 9, 9, 9, 9, NAN};
  fmi2Boolean enters = 9, ends = 9;
  fmi2Status status = fmi2Fatal;
  flex_phase next = one->now.phase;
  switch (call) {
    case call_fmi2EnterEventMode: status = fmi2EnterEventMode(c), next = EVENT_MODE; break;
    case call_fmi2EnterContinuousTimeMode: status = fmi2EnterContinuousTimeMode(c), next = CONTINUOUS_TIME_MODE; break;
    case call_fmi2NewDiscreteStates: status = fmi2NewDiscreteStates(c, is_lacking ? NULL : &info); break;
    case call_fmi2CompletedIntegratorStep:
      status = fmi2CompletedIntegratorStep(c, fmi2True, is_lacking ? NULL : &enters, choice == 248 ? NULL : &ends);
      CHECK(status != fmi2OK || ((enters == fmi2False || (enters == fmi2True && N_INDICATORS > 0)) && ends == fmi2False));
      break;
    case call_fmi2SetTime: status = fmi2SetTime(c, time); break;
    case call_fmi2SetContinuousStates: status = fmi2SetContinuousStates(c, states, size); break;
    case call_fmi2GetContinuousStates: status = fmi2GetContinuousStates(c, states, size), reads = 1; break;
    case call_fmi2GetDerivatives: status = fmi2GetDerivatives(c, states, size), reads = 1; break;
    case call_fmi2GetNominalsOfContinuousStates:
      status = fmi2GetNominalsOfContinuousStates(c, states, size), reads = 1;
      break;
    case call_fmi2GetEventIndicators: status = fmi2GetEventIndicators(c, states, choice % 16 ? N_INDICATORS : size); break;
    default: CHECK(!"a call of model exchange");
  }
  fuzzed_judge(one, call, status);
  if (status != fmi2OK) return;
  one->now.phase = next;
  if (call == call_fmi2SetTime) one->now.time = time;
  if (call == call_fmi2NewDiscreteStates) CHECK(!info.newDiscreteStatesNeeded && !info.terminateSimulation);
  if (reads) CHECK(!is_lacking && size == N_STATES);
  if (reads) note_reals(one, status, x, size);
}
#endif

static int concerns_exchange(flex_call_id call) {
  return call >= call_fmi2EnterContinuousTimeMode && call <= call_fmi2NewDiscreteStates;
}

// through bytes, which are spoilt now and then
static fmi2FMUstate deserialized(fuzzed *one, tape *tape, fmi2FMUstate state) {
  size_t size = 0;
  fmi2FMUstate copy = NULL;
  if (fmi2SerializedFMUstateSize(one->component, state, &size) != fmi2OK) return NULL;
  fmi2Byte *bytes = malloc(size + 1);
  CHECK(bytes != NULL && fmi2SerializeFMUstate(one->component, state, bytes, size) == fmi2OK);
  memcpy(one->before, one->ear->n_heard, sizeof one->before);
  unsigned spoil = tape_byte(tape), where = tape_byte(tape) * 256 + tape_byte(tape);
  size_t given = size;
  if (spoil % 4 == 0) bytes[where % size] ^= (fmi2Byte)(1 << spoil / 32);
  if (spoil % 4 == 1) given = where % 2 ? where % size : size + 1;
  bytes[size] = 0;
  fmi2Status status = fmi2DeSerializeFMUstate(one->component, bytes, given, &copy);
  fuzzed_judge(one, call_fmi2DeSerializeFMUstate, status);
  CHECK((status == fmi2OK) == (spoil % 4 > 1 && copy != NULL));
  free(bytes);
  return copy;
}

static void serve_state(fuzzed *one, tape *tape, flex_call_id call) {
  fmi2Component c = one->component;
  unsigned choice = tape_byte(tape), slot = choice % N_SLOTS;
  fmi2FMUstate *state = &one->slots[slot], stale = *state;
  int is_lacking = choice > 240;
  size_t size = 0;
  fmi2Byte small[8];
  fmi2Status status = fmi2Fatal;
  switch (call) {
    case call_fmi2GetFMUstate:
      status = fmi2GetFMUstate(c, is_lacking ? NULL : state);
      if (status == fmi2OK) one->saved[slot] = one->now;
      break;
    case call_fmi2SetFMUstate:
      status = fmi2SetFMUstate(c, is_lacking ? NULL : *state);
      break;
    case call_fmi2FreeFMUstate:
      status = fmi2FreeFMUstate(c, is_lacking ? NULL : state);
      CHECK(is_lacking || *state == NULL);
      break;
    case call_fmi2SerializedFMUstateSize: status = fmi2SerializedFMUstateSize(c, *state, is_lacking ? NULL : &size); break;
    case call_fmi2SerializeFMUstate: status = fmi2SerializeFMUstate(c, *state, is_lacking ? NULL : small, sizeof small); break;
    case call_fmi2DeSerializeFMUstate: status = fmi2DeSerializeFMUstate(c, is_lacking ? NULL : small, 0, state); break;
    default: CHECK(!"a call that concerns FMU states");
  }
  fuzzed_judge(one, call, status);
  if (call == call_fmi2SetFMUstate && status == fmi2OK) one->now = one->saved[slot];

  // the same state freed twice
  if (call == call_fmi2FreeFMUstate && stale && choice % 16 == 0 && !is_lacking) {
    memcpy(one->before, one->ear->n_heard, sizeof one->before);
    fuzzed_judge(one, call, fmi2FreeFMUstate(c, &stale));
    CHECK(stale != NULL);
  }

  // a copy by way of bytes replaces the state
  if (call == call_fmi2SerializeFMUstate && *state) {
    fmi2FMUstate copy = deserialized(one, tape, *state);
    if (copy) {
      CHECK(fmi2FreeFMUstate(c, state) == fmi2OK);
      *state = copy;
    }
  }
}

static int concerns_states(flex_call_id call) {
  return call >= call_fmi2GetFMUstate && call <= call_fmi2DeSerializeFMUstate;
}

static void serve(fuzzed *one, tape *tape, flex_call_id call) {
  memcpy(one->before, one->ear->n_heard, sizeof one->before);
  doing = calls[call].name;
  switch (call) {
    case call_fmi2SetDebugLogging: serve_logging(one, tape); break;
    case call_fmi2SetupExperiment: serve_setup(one, tape); break;
    case call_fmi2DoStep: serve_step(one, tape); break;
    case call_fmi2GetDirectionalDerivative: serve_derivative(one, tape); break;
    case call_fmi2EnterInitializationMode:
    case call_fmi2ExitInitializationMode:
    case call_fmi2Terminate:
    case call_fmi2Reset:
    case call_fmi2CancelStep: serve_mode(one, call); break;
    case call_fmi2GetStatus:
    case call_fmi2GetRealStatus:
    case call_fmi2GetIntegerStatus:
    case call_fmi2GetBooleanStatus:
    case call_fmi2GetStringStatus: serve_status(one, tape, call); break;
    default:
#ifdef N_STATES
      if (concerns_exchange(call)) {
        serve_exchange(one, tape, call);
        break;
      }
#endif
      if (concerns_states(call))
        serve_state(one, tape, call);
      else
        serve_values(one, tape, call);
  }
}

// half of the calls are those of an importer that simulates
static flex_call_id choose(const fuzzed *one, tape *tape) {
  static const flex_call_id usual[] = {call_fmi2DoStep,  call_fmi2DoStep,  call_fmi2DoStep,
                                       call_fmi2SetReal, call_fmi2GetReal, call_fmi2SetRealInputDerivatives,
                                       call_fmi2DoStep,  call_fmi2GetReal};
  static const flex_call_id exchanged[] = {call_fmi2EnterContinuousTimeMode, call_fmi2SetTime,
                                           call_fmi2SetContinuousStates,     call_fmi2GetDerivatives,
                                           call_fmi2GetReal,                 call_fmi2SetReal,
                                           call_fmi2CompletedIntegratorStep, call_fmi2GetContinuousStates};
  unsigned choice = tape_byte(tape);
  if (choice >= 128) return (flex_call_id)(choice % N_CALLS);
  return one->type == fmi2ModelExchange ? exchanged[choice % 8] : usual[choice % 8];
}

static unsigned long fuzzed_count;

// one call that the tape chooses; where `is_numeric`, only calls that depend on nothing but the FMU state
static void fuzzed_call(fuzzed *one, tape *tape, int is_numeric) {
  flex_call_id call = choose(one, tape);
  if (is_numeric && (concerns_states(call) || call == call_fmi2SetDebugLogging)) return;

#ifndef N_STATES
  if (concerns_exchange(call)) return;
#endif

  // few of them, or the others would never get far
  int is_drastic = call == call_fmi2Reset || call == call_fmi2Terminate;
  if (is_drastic && tape_byte(tape) % 4 != 0) return;
  fuzzed_count++;
  serve(one, tape, call);
}

// frees saved states and the instance, in whatever state it is
static void fuzzed_end(fuzzed *one) {
  doing = "freeing";
  for (int i = 0; i < N_SLOTS; i++) CHECK(fmi2FreeFMUstate(one->component, &one->slots[i]) == fmi2OK);
  fmi2FreeInstance(one->component);
}

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
  doing = "rolling back";
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
  doing = "replaying";
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
  doing = "making the reference run";
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
  doing = "instantiating";
  if (choice & 2) is_out_of_memory = 1;
  CHECK(instantiate(&ear, fmi2CoSimulation, "fuzzed", choice & 2 ? GUID : "{somebody else}", fmi2False) == NULL);
  CHECK(ear.n_heard[LOG_ERROR] == 1 && ear.status == fmi2Error);
}

static void to_the_first_step(fuzzed *one) {
  fmi2Component c = one->component;
  CHECK(fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK);
  CHECK(fmi2EnterInitializationMode(c) == fmi2OK && fmi2ExitInitializationMode(c) == fmi2OK);
  one->now.phase = one->type == fmi2CoSimulation ? STEP_COMPLETE : EVENT_MODE;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

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
  CHECK(n_live == 0);
  return 0;
}

#ifndef LIBFUZZER
enum { LONGEST = 400, PATIENCE = 60 };

// SplitMix64 (Steele, Lea, Flood 2014)
static uint64_t draw(uint64_t *state) {
  uint64_t z = (*state += 0x9e3779b97f4a7c15ULL);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31);
}

// arguments: how many, and the number of the first, which alone decides what it is
int main(int argc, char **argv) {
  unsigned long count = argc > 1 ? strtoul(argv[1], NULL, 10) : 1000, first = argc > 2 ? strtoul(argv[2], NULL, 10) : 0;
  static unsigned long current;
  for (current = first; current < first + count; current++) {
    uint8_t bytes[LONGEST];
    uint64_t state = current;
    size_t size = 8 + draw(&state) % (LONGEST - 8);
    for (size_t i = 0; i < size; i++) bytes[i] = (uint8_t)(draw(&state) >> 56);

    // nothing hangs
    alarm(PATIENCE);
    if (getenv("FUZZ_TRACE")) fprintf(stderr, "sequence %lu\n", current);
    LLVMFuzzerTestOneInput(bytes, size);
  }
  printf("%lu sequences, %lu calls\n", count, fuzzed_count);
  return 0;
}
#endif

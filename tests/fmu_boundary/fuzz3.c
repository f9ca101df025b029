/* Sequences of calls of FMI 3.0, drawn: what the table of states forbids is an error, every other status than fmi3OK is explained, and
 * after a reset the run equals that of a new instance. The numerical part is fuzzed by fuzz.c; the build defines the same sizes. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"

enum { MOST = 24 };

static const struct {
  const char *name;
  int kinds, phases;
} calls[] = {
#define X(function, kinds, phases) {#function, kinds, phases},
    FLEX_FMI3_CALLS(X)
#undef X
};

static unsigned long long seed;
static int heard;

static unsigned draw(unsigned count) {
  seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
  return count ? (unsigned)(seed >> 33) % count : 0;
}

static double number(void) {
  static const double odd[] = {NAN, INFINITY, 1e300, -1.0, 0.0, 5e-324};
  return draw(8) ? ((double)draw(2001) - 1000.0) / 2000.0 : odd[draw(6)];
}

static void hear(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
  (void)environment, (void)category;
  heard += status != fmi3OK && *message;
}

static fmi3Instance updated;

// an importer that sets and reads within steps, and ends some of them
static void update(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean asks, fmi3Boolean reads, fmi3Boolean finished,
                   fmi3Boolean may_end, fmi3Boolean *ends, fmi3Float64 *when) {
  (void)environment, (void)time, (void)finished, (void)when;
  fmi3ValueReference first = asks ? 0 : N_SETTABLE;
  fmi3Float64 value = number();
  if (asks && draw(16)) fmi3SetFloat64(updated, &first, 1, &value, 1);
  if (reads) fmi3GetFloat64(updated, &first, 1, &value, 1);
  *ends = may_end && !draw(4);
}

// with events: 0 = no event mode, 1 = with it, 2 = steps end at events, 3 = and have intermediate updates
static fmi3Instance made(flex_kind kind, unsigned events) {
  static const fmi3ValueReference used[] = {0, N_SETTABLE};
  size_t count = events > 2 ? 2 : 0;
  fmi3Instance found = kind == EXCHANGE ? fmi3InstantiateModelExchange("one", GUID, NULL, 0, 1, NULL, hear)
                                        : fmi3InstantiateCoSimulation("one", GUID, NULL, 0, 1, events > 0, events > 1, used, count,
                                                                      NULL, hear, count ? update : NULL);
  updated = found;
  return found ? found : (printf("no instance\n"), exit(1), NULL);
}

static fmi3ValueReference reference(void) {
  unsigned sort = draw(8) ? 0 : draw(7), count = draw(16) ? N_REALS : 0x0fffffff;
  return sort << 28 | draw(sort == FLEX_INTEGER ? N_INTEGERS + 1 : sort == FLEX_INPUT_DERIVATIVES ? N_INPUTS + 1 : count);
}

static fmi3Status call(fmi3Instance one, flex_call_id id, fmi3FMUState *state) {
  fmi3ValueReference vr[MOST], other[2];
  fmi3Float64 values[16 * MOST], results[16 * MOST];
  fmi3Int32 orders[MOST], small[MOST];
  fmi3Int64 large[MOST];
  fmi3Boolean flags[5] = {draw(2)};
  size_t count = draw(4), size = count, length = 0;
  static fmi3Byte bytes[1 << 20];
  for (size_t i = 0; i < MOST; i++) vr[i] = reference(), orders[i] = (int)draw(4), small[i] = (int)draw(9) - 1, large[i] = small[i];
  for (size_t i = 0; i < 16 * MOST; i++) values[i] = number();
  other[0] = reference(), other[1] = reference();
  for (size_t i = 0; i < count; i++)
    if (vr[i] >> 28 == FLEX_INPUT_DERIVATIVES) size += (size_t)((flex_instance *)one)->backend->max_input_order - 1;
  size += draw(32) == 0;
  const fmi3ValueReference *where = draw(64) ? vr : NULL;
  switch (id) {
    case call_fmi3SetDebugLogging: return fmi3SetDebugLogging(one, 1, 0, NULL);
    case call_fmi3EnterInitializationMode: return fmi3EnterInitializationMode(one, draw(2), number(), 0.0, draw(2), 1.0);
    case call_fmi3ExitInitializationMode: return fmi3ExitInitializationMode(one);
    case call_fmi3EnterEventMode: return fmi3EnterEventMode(one);
    case call_fmi3Terminate: return draw(8) ? fmi3OK : fmi3Terminate(one);
    case call_fmi3Reset: return draw(8) ? fmi3OK : fmi3Reset(one);
    case call_fmi3GetFloat64: return fmi3GetFloat64(one, where, count, results, size);
    case call_fmi3GetInt32: return fmi3GetInt32(one, where, count, small, size);
    case call_fmi3GetInt64: return fmi3GetInt64(one, where, count, large, size);
    case call_fmi3SetFloat64: return fmi3SetFloat64(one, where, count, values, size);
    case call_fmi3SetInt32: return fmi3SetInt32(one, where, count, small, size);
    case call_fmi3SetInt64: return fmi3SetInt64(one, where, count, large, size);
    case call_fmi3GetFMUState: return fmi3GetFMUState(one, state);
    case call_fmi3SetFMUState: return fmi3SetFMUState(one, *state);
    case call_fmi3FreeFMUState: return fmi3FreeFMUState(one, state);
    case call_fmi3SerializedFMUStateSize: return fmi3SerializedFMUStateSize(one, *state, &length);
    case call_fmi3SerializeFMUState: return fmi3SerializeFMUState(one, *state, bytes, sizeof bytes);
    case call_fmi3DeserializeFMUState:
      fmi3FreeFMUState(one, state);
      return fmi3DeserializeFMUState(one, bytes, sizeof bytes, state);
    case call_fmi3GetDirectionalDerivative:
      return fmi3GetDirectionalDerivative(one, where, count, other, 2, values, 2, results, size);
    case call_fmi3GetAdjointDerivative: return fmi3GetAdjointDerivative(one, where, count, other, 2, values, size, results, 2);
    case call_fmi3UpdateDiscreteStates:
      return fmi3UpdateDiscreteStates(one, flags, flags + 1, flags + 2, flags + 3, draw(32) ? flags + 4 : NULL, results);
    case call_fmi3EnterContinuousTimeMode: return fmi3EnterContinuousTimeMode(one);
    case call_fmi3CompletedIntegratorStep: return fmi3CompletedIntegratorStep(one, 1, flags, flags + 1);
    case call_fmi3SetTime: return fmi3SetTime(one, number());
    case call_fmi3SetContinuousStates: return fmi3SetContinuousStates(one, values, flex_backend_states() + !draw(16));
    case call_fmi3GetContinuousStateDerivatives: return fmi3GetContinuousStateDerivatives(one, results, flex_backend_states());
    case call_fmi3GetEventIndicators: return fmi3GetEventIndicators(one, results, flex_backend_indicators());
    case call_fmi3GetContinuousStates: return fmi3GetContinuousStates(one, results, flex_backend_states());
    case call_fmi3GetNominalsOfContinuousStates: return fmi3GetNominalsOfContinuousStates(one, results, flex_backend_states());
    case call_fmi3GetNumberOfEventIndicators: return fmi3GetNumberOfEventIndicators(one, draw(32) ? &length : NULL);
    case call_fmi3GetNumberOfContinuousStates: return fmi3GetNumberOfContinuousStates(one, &length);
    case call_fmi3SetClock: {
      const fmi3ValueReference clock = FLEX_CLOCK << 28 | !draw(8);
      return fmi3SetClock(one, &clock, 1, flags);
    }
    case call_fmi3EnterStepMode: return fmi3EnterStepMode(one);
    case call_fmi3GetOutputDerivatives: return fmi3GetOutputDerivatives(one, where, count, orders, results, size);
    case call_fmi3DoStep: {
      double step = draw(4) ? 1e-3 : number();
      return fmi3DoStep(one, *((flex_instance *)one)->backend->time, step, 1, flags, flags + 1, flags + 2, results);
    }
  }
  return fmi3OK;
}

// outputs after a few steps from the start values
static void run(fmi3Instance one, double *outputs) {
  fmi3Boolean flags[3];
  double last;
  int failed = fmi3EnterInitializationMode(one, 0, 0.0, 0.0, 0, 0.0) | fmi3ExitInitializationMode(one);
  for (int i = 0; i < 3; i++) failed |= fmi3DoStep(one, i * 1e-3, 1e-3, 1, flags, flags + 1, flags + 2, &last);
  for (unsigned i = N_SETTABLE; i < N_REALS; i++) failed |= fmi3GetFloat64(one, &i, 1, outputs + i, 1);
  if (failed) printf("the reference run fails\n"), exit(1);
}

int main(int argc, char **argv) {
  static double first[N_REALS], again[N_REALS];
  int sequences = argc > 1 ? atoi(argv[1]) : 1;
  fmi3Instance fresh = made(STEPPING, 0);
  run(fresh, first);
  fmi3FreeInstance(fresh);
  for (int number = 0; number < sequences; number++) {
    seed = (unsigned long long)number + 1;
    flex_kind kind = N_STATES && draw(2) ? EXCHANGE : STEPPING;
    fmi3Instance one = made(kind, draw(N_STATES ? 4 : 2));
    fmi3FMUState state = NULL;
    for (int i = 0; i < 150; i++) {
      unsigned id = draw(sizeof calls / sizeof *calls);
      int is_legal = (calls[id].kinds & (int)kind) && (calls[id].phases & ((flex_instance *)one)->session.phase);
      int before = heard;
      fmi3Status status = call(one, (flex_call_id)id, &state);
      if ((unsigned)status > fmi3Error || (status != fmi3OK && heard == before) ||
          (!is_legal && status != fmi3Error && id != call_fmi3Reset && id != call_fmi3Terminate))
        printf("sequence %d: %s gives %d, %d messages\n", number, calls[id].name, (int)status, heard - before), exit(1);
    }
    fmi3FreeFMUState(one, &state);
    fmi3Reset(one);
    if (kind == STEPPING && !((flex_instance *)one)->session.has_events) {
      run(one, again);
      if (memcmp(first, again, sizeof first) != 0) printf("sequence %d: a reset instance runs otherwise\n", number), exit(1);
    }
    fmi3FreeInstance(one);
  }
  printf("%d sequences\n", sequences);
  return 0;
}

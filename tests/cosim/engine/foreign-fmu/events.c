/* A plain FMI 3.0 co-simulation FMU as another tool might make it, strict about the order of calls.
 *
 * x' = slope, and x falls back to 0 where it reaches 1: a state event, at which fmi3DoStep returns early in event mode.
 * A time event every 0.25 s counts `ticks`; without event mode the FMU handles both itself. y = A u + offset with arrays of
 * the size that the structural parameter n has, and an output for each type follows the input of this type. Discrete inputs
 * are refused in step mode when events are used. `trouble` ends the run, fails, hangs or claims events for ever from 0.5 s on.
 *
 * Clocks, if the description has them: one of 0.25 s from 0.1 s on, of `w` and of `sum`, which is that of all w so far; one whose
 * intervals are 0.1 s, 0.2 s, 0.3 s ...; one that ticks 0.07 s after the first one's third tick; an input, and an output that ticks
 * with each second tick of the first; and one of 0.3 s from 0.05 s on, as the FMU says. They are used in their ticks alone. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef uint32_t reference;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } status;
typedef void logger(void *environment, status level, const char *category, const char *message);
typedef enum { INSTANTIATED, CONFIGURATION, INITIALIZATION, EVENT, STEP } phase;

enum { NONE = 1, ENDS, FAILS, RETURNS, UPDATES };
enum { LARGEST = 4, TYPES = 11 };
enum { PERIODIC, CHANGING, COUNTDOWN, INPUT, OUTPUT, FIXED, CLOCKS };

typedef struct {
  phase phase;
  bool events, early;
  double time, next, x, slope, u[LARGEST], y[LARGEST], A[LARGEST * LARGEST], offset;
  double number[TYPES]; /* of each type: the input that comes out again */
  uint64_t n;
  int64_t trouble;
  int32_t ticks, falls, count[CLOCKS];
  bool active[CLOCKS], armed;
  double w, sum, total;
  char text[64], resources[512];
  logger *log;
} model;

static status refuse(model *m, const char *message) {
  m->log(NULL, ERROR, "error", message);
  return ERROR;
}

static void fall(model *m) { /* whatever is due now */
  if (m->x > 1.0 - 1e-12) m->x = 0.0, m->falls++;
  if (m->time > m->next - 1e-12) m->ticks++, m->next += 0.25;
}

/* Where a value is, how many there are, and whether it may be set now; NULL for what there isn't. */
static void *place(model *m, reference r, size_t *count) {
  *count = 1;
  if (r >= 100 && r < 100 + TYPES) return &m->number[r - 100];
  if (r >= 200 && r < 200 + TYPES) return &m->number[r - 200];
  switch (r) {
    case 1: return &m->x;
    case 2: return &m->slope;
    case 3: *count = m->n; return m->u;
    case 4: *count = m->n; return m->y;
    case 5: *count = m->n * m->n; return m->A;
    case 6: return &m->offset;
    case 60: return &m->w;
    case 61: return &m->total;
    default: return NULL;
  }
}

/* whether a clock of the variable is active, if it has any */
static bool ticks(const model *m, reference r) {
  if (m->phase == INITIALIZATION) return true;
  return r >= 50 && r < 50 + CLOCKS ? m->active[r - 50] : r == 60 || r == 61 ? m->active[PERIODIC] : true;
}

static status settable(model *m, reference r, bool discrete) {
  if (r >= 200 || r == 1 || r == 4) return refuse(m, "an output can't be set");
  if (m->phase == CONFIGURATION && r != 7) return refuse(m, "only structural parameters are set in configuration mode");
  if (m->phase != CONFIGURATION && r == 7) return refuse(m, "structural parameters are set in configuration mode");
  if (!ticks(m, r)) return refuse(m, "a clocked variable is set in a tick of its clock");
  if (m->phase == STEP && m->events && discrete) return refuse(m, "a discrete input is set at an event");
  return OK;
}

static void follow(model *m) { /* y = A u + offset */
  for (uint64_t i = 0; i < m->n; i++) {
    m->y[i] = m->offset;
    for (uint64_t j = 0; j < m->n; j++) m->y[i] += m->A[i * m->n + j] * m->u[j];
  }
  m->total = m->sum + m->w;
}

#define NUMBERS(Name, type, discrete)                                                                                          \
  status fmi3Get##Name(void *c, const reference r[], size_t count, type value[], size_t size) {                                \
    model *m = c;                                                                                                              \
    size_t k = 0, values;                                                                                                      \
    follow(m);                                                                                                                 \
    for (size_t i = 0; i < count; i++) {                                                                                       \
      const double *from = place(m, r[i], &values);                                                                            \
      if (!ticks(m, r[i])) return refuse(m, "a clocked variable is read in a tick of its clock");                             \
      const double whole = r[i] >= 50 && r[i] < 50 + CLOCKS ? m->count[r[i] - 50] : r[i] == 7 ? (double)m->n : r[i] == 8 ? (double)m->trouble : r[i] == 9 ? m->ticks : m->falls;        \
      if (k + values > size) return refuse(m, "too few values");                                                               \
      for (size_t j = 0; j < values; j++) value[k++] = (type)(from != NULL ? from[j] : whole);                                 \
    }                                                                                                                          \
    return k == size ? OK : refuse(m, "too many values");                                                                      \
  }                                                                                                                            \
  status fmi3Set##Name(void *c, const reference r[], size_t count, const type value[], size_t size) {                          \
    model *m = c;                                                                                                              \
    size_t k = 0, values;                                                                                                      \
    for (size_t i = 0; i < count; i++) {                                                                                       \
      double *to = place(m, r[i], &values);                                                                                    \
      if (settable(m, r[i], discrete) > OK) return ERROR;                                                                      \
      if (k + values > size) return refuse(m, "too few values");                                                               \
      if (r[i] == 7) m->n = (uint64_t)value[k++];                                                                              \
      else if (r[i] == 8) m->trouble = (int64_t)value[k++];                                                                    \
      else if (to == NULL) return refuse(m, "there is no such variable");                                                      \
      else for (size_t j = 0; j < values; j++) to[j] = (double)value[k++];                                                     \
    }                                                                                                                          \
    return k == size ? OK : refuse(m, "too many values");                                                                      \
  }

NUMBERS(Float32, float, false)
NUMBERS(Float64, double, false)
NUMBERS(Int8, int8_t, true)
NUMBERS(UInt8, uint8_t, true)
NUMBERS(Int16, int16_t, true)
NUMBERS(UInt16, uint16_t, true)
NUMBERS(Int32, int32_t, true)
NUMBERS(UInt32, uint32_t, true)
NUMBERS(Int64, int64_t, true)
NUMBERS(UInt64, uint64_t, true)
NUMBERS(Boolean, bool, true)

status fmi3GetString(void *c, const reference r[], size_t count, const char *value[], size_t size) {
  for (size_t i = 0; i < count && i < size; i++) value[i] = r[i] == 21 ? ((model *)c)->resources : ((model *)c)->text;
  return OK;
}

status fmi3SetString(void *c, const reference r[], size_t count, const char *const value[], size_t size) {
  if (count != size || settable(c, r[0], true) > OK) return ERROR;
  strncpy(((model *)c)->text, value[0], sizeof ((model *)c)->text - 1);
  return OK;
}

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging, bool events,
                                  bool early, const reference required[], size_t requirements, void *environment, logger *log,
                                  void *update) {
  (void)name, (void)visible, (void)logging, (void)required, (void)requirements, (void)environment, (void)update;
  if (strcmp(token, "events") != 0) return NULL;
  model *m = calloc(1, sizeof *m);
  m->events = events, m->early = early, m->log = log;
  m->slope = 1.0, m->n = 2, m->trouble = NONE;
  for (int i = 0; i < 2; i++) m->A[3 * i] = 1.0, m->u[i] = i + 1.0;
  strcpy(m->text, "none");
  strncpy(m->resources, resources == NULL ? "no resources" : resources, sizeof m->resources - 1);
  return m;
}

void fmi3FreeInstance(void *c) { free(c); }

static status go(model *m, phase from, phase to) {
  if (m->phase != from) return refuse(m, "this mode can't be entered now");
  m->phase = to;
  return OK;
}

status fmi3EnterConfigurationMode(void *c) { return go(c, INSTANTIATED, CONFIGURATION); }
status fmi3ExitConfigurationMode(void *c) { return go(c, CONFIGURATION, INSTANTIATED); }
status fmi3ExitInitializationMode(void *c) { return go(c, INITIALIZATION, ((model *)c)->events ? EVENT : STEP); }
status fmi3EnterEventMode(void *c) { return go(c, STEP, EVENT); }
status fmi3EnterStepMode(void *c) { return go(c, EVENT, STEP); }
status fmi3Terminate(void *c) { (void)c; return OK; }

status fmi3EnterInitializationMode(void *c, bool defined, double tolerance, double start, bool stops, double stop) {
  (void)defined, (void)tolerance, (void)stops, (void)stop;
  ((model *)c)->time = start;
  ((model *)c)->next = start + 0.25;
  return go(c, INSTANTIATED, INITIALIZATION);
}

status fmi3UpdateDiscreteStates(void *c, bool *again, bool *ends, bool *nominals, bool *states, bool *timed, double *time) {
  model *m = c;
  if (m->phase != EVENT) return refuse(m, "discrete states are updated at an event");
  const int before = m->falls + m->ticks;
  if (m->active[PERIODIC]) m->sum += m->w, m->armed = m->count[PERIODIC] == 3;
  memset(m->active, 0, sizeof m->active);
  fall(m);
  *again = m->falls + m->ticks > before || (m->trouble == UPDATES && m->time > 0.5 - 1e-9);
  *ends = *nominals = *states = false;
  *timed = true;
  *time = m->next;
  return OK;
}

status fmi3SetClock(void *c, const reference r[], size_t count, const bool value[]) {
  model *m = c;
  if (m->phase != EVENT) return refuse(m, "clocks tick in event mode");
  for (size_t i = 0; i < count; i++)
    if (value[i]) m->active[r[i] - 40] = true, m->count[r[i] - 40]++;
  return OK;
}

status fmi3GetClock(void *c, const reference r[], size_t count, bool value[]) {
  model *m = c;
  if (m->phase != EVENT || count != 1 || r[0] != 40 + OUTPUT) return refuse(m, "there is no such clock now");
  value[0] = m->active[PERIODIC] && m->count[PERIODIC] % 2 == 0;
  if (value[0] && !m->active[OUTPUT]) m->active[OUTPUT] = true, m->count[OUTPUT]++;
  return OK;
}

status fmi3GetIntervalDecimal(void *c, const reference r[], size_t count, double interval[], int qualifier[]) {
  model *m = c;
  const int clock = (int)r[0] - 40;
  if ((m->phase != EVENT && m->phase != INITIALIZATION) || count != 1) return refuse(m, "the interval isn't known now");
  interval[0] = clock == CHANGING ? 0.1 * (m->count[CHANGING] + 1) : clock == FIXED ? 0.3 : 0.07;
  qualifier[0] = clock == COUNTDOWN && !m->armed ? 0 : 2;
  m->armed = m->armed && clock != COUNTDOWN;
  return OK;
}

status fmi3GetShiftDecimal(void *c, const reference r[], size_t count, double shift[]) {
  shift[0] = 0.05;
  return ((model *)c)->phase == INITIALIZATION && count == 1 && r[0] == 40 + FIXED ? OK : ERROR;
}

status fmi3DoStep(void *c, double point, double step, bool forward, bool *event, bool *ends, bool *early, double *reached) {
  (void)forward;
  model *m = c;
  if (m->phase != STEP || fabs(point - m->time) > 1e-9) return refuse(m, "the step doesn't begin where the last one has ended");
  const double end = point + step;
  *event = *ends = *early = false;
  while (m->time < end - 1e-12) {
    const double left = m->slope > 0.0 ? (1.0 - m->x) / m->slope : 1e9;
    double part = fmin(left, end - m->time);
    if (!m->events) part = fmin(part, m->next - m->time);
    if (m->trouble != NONE && m->time + part > 0.5 + 1e-9) {
      part = fmax(0.5 - m->time, 0.0);
      *ends = m->trouble == ENDS;
      *early = *event = m->trouble == RETURNS;
      if (m->trouble == FAILS) return refuse(m, "tired");
    }
    m->x += m->slope * part;
    m->time += part;
    if (*ends || *early) break;
    if (!m->events) fall(m);
    else if (m->x > 1.0 - 1e-12) {
      *event = true;
      *early = m->early && m->time < end - 1e-12;
      if (m->early) break;
    }
  }
  *reached = m->time;
  return OK;
}

status fmi3GetOutputDerivatives(void *c, const reference r[], size_t count, const int32_t order[], double value[], size_t size) {
  size_t k = 0, values;
  for (size_t i = 0; i < count; i++) {
    (void)place(c, r[i], &values);
    for (size_t j = 0; j < values && k < size; j++) value[k++] = r[i] == 1 && order[i] == 1 ? ((model *)c)->slope : NAN;
  }
  return OK;
}

status fmi3GetFMUState(void *c, void **state) {
  if (*state == NULL) *state = malloc(sizeof(model));
  memcpy(*state, c, sizeof(model));
  return OK;
}

status fmi3SetFMUState(void *c, void *state) {
  memcpy(c, state, sizeof(model));
  return OK;
}

status fmi3FreeFMUState(void *c, void **state) {
  (void)c;
  free(*state);
  *state = NULL;
  return OK;
}

/* A trajectory behind the FMI layer, evaluated on demand, at breakpoints the limit that is asked for; reals are the outputs: positions of
 * all axes, velocities, accelerations. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "backend.h"
#include "clock.h"
#include "memory.h"
#include "refusal.h"
#include "trajectory_model.h"

/* which limit is shown where the trajectory jumps */
typedef enum { FLEX_LEFT = 1, FLEX_RIGHT = 2 } flex_limit;

enum { ENDS = FLEX_END_ORDER + 1, TERMS = 2 * ENDS };

/* Two-point Hermite interpolation in s = 0..1: the normalised coefficients c_0..c_4 are given at s = 0; c_5..c_9 follow
 * from what is missing at s = 1 by the inverse of the matrix C(5 + j, i), which is integer. */
static const double end_matrix[ENDS][ENDS] = {
    {126, -56, 21, -6, 1},
    {-420, 196, -77, 23, -4},
    {540, -260, 106, -33, 6},
    {-315, 155, -65, 21, -4},
    {70, -35, 15, -5, 1},
};

// number of knots before a time, those at the time itself included on request
static int count_knots(double time, int included) {
  int low = 0, high = flex_the_trajectory.n_knots;
  while (low < high) {
    int middle = low + (high - low) / 2;
    int is_before = included ? flex_the_trajectory.times[middle] <= time : flex_the_trajectory.times[middle] < time;
    if (is_before)
      low = middle + 1;
    else
      high = middle;
  }
  return low;
}

static int is_breakpoint(int knot) {
  const double *t = flex_the_trajectory.times;
  if (knot == 0 || knot == flex_the_trajectory.n_knots - 1) return 1;
  return t[knot] == t[knot - 1] || t[knot] == t[knot + 1];
}

// where breakpoints are within `slack` of a time, the first of them from the left, the last of them from the right; else the time
// itself
static double landing(double time, double slack, flex_limit limit) {
  double found_time = time;
  int found = 0;
  for (int i = count_knots(time - slack, 0); i < flex_the_trajectory.n_knots && flex_the_trajectory.times[i] <= time + slack; i++) {
    if (!is_breakpoint(i) || (found && limit == FLEX_LEFT)) continue;
    found_time = flex_the_trajectory.times[i];
    found = 1;
  }
  return found_time;
}

// the first breakpoint after a time, HUGE_VAL behind the last
static double next_breakpoint(double time) {
  for (int i = count_knots(time, 1); i < flex_the_trajectory.n_knots; i++)
    if (is_breakpoint(i)) return flex_the_trajectory.times[i];
  return HUGE_VAL;
}

// coefficients of the polynomial in s between normalised derivatives at s = 0 and s = 1
static void hermite(const double *begin, const double *end, double *c) {
  double missing[ENDS];
  for (int i = 0; i < ENDS; i++) {
    double binomial = 1.0;
    missing[i] = end[i];
    for (int j = i; j < ENDS; j++) {
      missing[i] -= binomial * begin[j];
      binomial = binomial * (j + 1) / (j + 1 - i);
    }
  }
  memcpy(c, begin, ENDS * sizeof *c);
  for (int i = 0; i < ENDS; i++) {
    c[ENDS + i] = 0.0;
    for (int j = 0; j < ENDS; j++) c[ENDS + i] += end_matrix[i][j] * missing[j];
  }
}

// the first coefficients of the same polynomial about another s
static void expand_about(double s, double *c) {
  for (int i = 0; i < ENDS; i++)
    for (int k = TERMS - 2; k >= i; k--) c[k] += s * c[k + 1];
}

// value and derivatives of one signal between two knots, from the nearer one: so they are exact at both
static void interpolate(const double *left, const double *right, int stride, double width, double after, double before,
                        double *result, int result_stride) {
  int is_mirrored = after > before;
  double begin[ENDS], end[ENDS], c[TERMS], scale = 1.0;
  for (int k = 0; k < ENDS; k++) {
    double sign = is_mirrored && k % 2 ? -1.0 : 1.0;
    begin[k] = sign * scale * (is_mirrored ? right : left)[k * stride];
    end[k] = sign * scale * (is_mirrored ? left : right)[k * stride];
    scale *= width / (k + 1);
  }
  hermite(begin, end, c);
  expand_about((is_mirrored ? before : after) / width, c);

  // back to derivatives in time
  scale = 1.0;
  for (int k = 0; k < ENDS; k++) {
    result[k * result_stride] = (is_mirrored && k % 2 ? -1.0 : 1.0) * c[k] / scale;
    scale *= width / (k + 1);
  }
}

// derivatives of the positions and velocities: the velocities and accelerations with theirs
static void complete(int n_axes, double *signals) {
  int n = FLEX_KINDS * n_axes;
  for (int k = 1; k < ENDS; k++) {
    double *row = signals + k * n, *above = signals + (k - 1) * n;
    for (int i = n_axes - 1; i >= 0; i--) {
      row[n_axes + i] = above[2 * n_axes + i];
      row[i] = above[n_axes + i];
    }
  }
}

// outputs and their derivatives up to FLEX_END_ORDER at a time: (FLEX_END_ORDER + 1) x FLEX_KINDS x n_axes
static void evaluate(double time, flex_limit limit, double *signals) {
  int axes = flex_the_trajectory.n_axes, n = FLEX_KINDS * axes, size = FLEX_KNOT_ORDERS * axes;
  int next = count_knots(time, limit == FLEX_RIGHT);
  memset(signals, 0, (size_t)(ENDS * n) * sizeof *signals);

  // standstill at the start or at the end
  if (next == 0 || next == flex_the_trajectory.n_knots) {
    const double *still = next == 0 ? flex_the_trajectory.jets : flex_the_trajectory.jets + (flex_the_trajectory.n_knots - 1) * size;
    memcpy(signals, still, (size_t)axes * sizeof *signals);
    return;
  }

  // between two knots
  const double *left = flex_the_trajectory.jets + (next - 1) * size, *right = left + size;
  double begin = flex_the_trajectory.times[next - 1], end = flex_the_trajectory.times[next];
  for (int i = 0; i < n; i++)
    interpolate(left + i, right + i, axes, end - begin, time - begin, end - time, signals + i, n);
  complete(axes, signals);
}

/* integers: the limit that is shown at breakpoints */
enum { FLEX_LIMIT, FLEX_N_INTEGERS };

/* the numeric state: all else follows from it */
typedef struct {
  double time;        /* [s] */
  double left, right; /* where the limits are taken: the time, or breakpoints that are the same instant */
  int limit;
  int passed; /* 1 = event mode has passed the present instant: right limits are shown */
} trajectory_record;

typedef struct {
  flex_backend base;
  trajectory_record *record;
  double *signals;          /* outputs and their derivatives, by rows */
  trajectory_record *shown; /* what they have been evaluated for */
  int is_evaluated;
  char message[FLEX_MESSAGE_SIZE];
} trajectory_backend;

static trajectory_backend *whole(flex_backend *backend) {
  return (trajectory_backend *)backend;
}

static int n_outputs(void) {
  return FLEX_KINDS * flex_the_trajectory.n_axes;
}

static trajectory_backend *take(flex_arena *arena) {
  trajectory_backend *backend = flex_take(arena, sizeof *backend);
  trajectory_record *record = flex_take(arena, sizeof *record), *shown = flex_take(arena, sizeof *shown);
  double *signals = flex_take_doubles(arena, (size_t)((FLEX_END_ORDER + 1) * n_outputs()));
  if (!arena->block) return NULL;
  backend->record = record;
  backend->shown = shown;
  backend->signals = signals;
  return backend;
}

const char *flex_backend_guid(void) {
  return flex_the_trajectory.guid;
}

size_t flex_backend_size(void) {
  flex_arena arena = {NULL, 0};
  take(&arena);
  return arena.used;
}

flex_backend *flex_backend_create(void *memory) {
  flex_arena arena = {memory, 0};
  trajectory_backend *backend = take(&arena);
  backend->base.state = backend->record;
  backend->base.state_size = sizeof *backend->record;
  backend->base.time = &backend->record->time;
  backend->base.message = backend->message;
  backend->base.n_outputs = (unsigned)(FLEX_KINDS * flex_the_trajectory.n_axes);
  flex_backend_reset(&backend->base);
  return &backend->base;
}

// to another instant; communication points and breakpoints within `slack` are one
static void go_to(trajectory_backend *backend, double time, double slack) {
  trajectory_record *record = backend->record;
  record->time = time;
  record->left = landing(time, slack, FLEX_LEFT);
  record->right = landing(time, slack, FLEX_RIGHT);
}

void flex_backend_reset(flex_backend *backend) {
  whole(backend)->record->limit = FLEX_LEFT;
  whole(backend)->record->passed = 0;
  go_to(whole(backend), 0.0, 0.0);
}

void flex_backend_set_start_time(flex_backend *backend, double time) {
  go_to(whole(backend), time, flex_time_slack(time, 0.0));
}

int flex_backend_begin(flex_backend *backend) {
  (void)backend;
  return 0;
}

int flex_backend_advance(flex_backend *backend, double t0, double t1, int *event) {
  double slack = flex_time_slack(t1, t1 - t0), next = next_breakpoint(t0 + slack);
  if (event) *event = next <= t1 + slack;
  whole(backend)->record->passed = 0;
  go_to(whole(backend), event && next < t1 - slack ? next : t1, slack);
  return 0;
}

int flex_backend_handle_event(flex_backend *backend, int is_exchange, int *states_changed, double *next) {
  (void)is_exchange, (void)states_changed;
  whole(backend)->record->passed = 1;
  *next = next_breakpoint(*backend->time + flex_time_slack(*backend->time, 0.0));
  return 0;
}

// an output or one of its derivatives, evaluated together with all others
static double signal(trajectory_backend *backend, int order, unsigned index) {
  const trajectory_record *record = backend->record, *shown = backend->shown;
  flex_limit limit = record->passed ? FLEX_RIGHT : (flex_limit)record->limit;
  double time = limit == FLEX_LEFT ? record->left : record->right;
  double shown_time = shown->limit == FLEX_LEFT ? shown->left : shown->right;
  if (!backend->is_evaluated || shown->limit != (int)limit || shown_time != time) {
    evaluate(time, limit, backend->signals);
    *backend->shown = *record;
    backend->shown->limit = (int)limit;
    backend->is_evaluated = 1;
  }
  return backend->signals[(unsigned)(order * n_outputs()) + index];
}

int flex_backend_get_reals(flex_backend *backend, const unsigned *index, size_t count, double *value) {
  for (size_t i = 0; i < count; i++) {
    if (flex_refuse_reference(backend->message, index[i], backend->n_outputs)) return 1;
    value[i] = signal(whole(backend), 0, index[i]);
  }
  return 0;
}

int flex_backend_set_real(flex_backend *backend, unsigned index, double value) {
  (void)value;
  char *message = backend->message;
  if (flex_refuse_reference(message, index, backend->n_outputs)) return 1;
  return flex_refuse(message, "%s is an output, it cannot be set", flex_the_trajectory.output_variables[index].name);
}

// there is one integer variable
static int refuse_integer(flex_backend *backend, unsigned index) {
  if (index == FLEX_LIMIT) return 0;
  return flex_refuse(whole(backend)->message, "value reference %u of an integer variable is unknown; there are %d", index,
                     FLEX_N_INTEGERS);
}

int flex_backend_get_integer(flex_backend *backend, unsigned index, int *value) {
  if (refuse_integer(backend, index)) return 1;
  *value = whole(backend)->record->limit;
  return 0;
}

int flex_backend_set_integer(flex_backend *backend, unsigned index, int value) {
  if (refuse_integer(backend, index)) return 1;
  if (value != FLEX_LEFT && value != FLEX_RIGHT)
    return flex_refuse(whole(backend)->message, "limit must be 1 (left) or 2 (right), got %d", value);
  whole(backend)->record->limit = value;
  return 0;
}

int flex_backend_set_input_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                       const double *value) {
  (void)order, (void)value;
  if (count == 0) return 0;
  return flex_refuse(whole(backend)->message, "value reference %u is no input, its derivatives cannot be set", *index);
}

static int get_output_derivative(flex_backend *backend, unsigned index, int order, double *value) {
  char *message = backend->message;
  if (flex_refuse_reference(message, index, backend->n_outputs)) return 1;
  if (order < 1 || order > FLEX_END_ORDER)
    return flex_refuse(message, "derivatives of %s are of order 1 to %d, got order %d",
                       flex_the_trajectory.output_variables[index].name, FLEX_END_ORDER, order);
  *value = signal(whole(backend), order, index);
  return 0;
}

double flex_backend_input_derivative(flex_backend *backend, unsigned input, int order) {
  return (void)backend, (void)input, (void)order, 0.0;
}

int flex_backend_get_output_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                        double *value) {
  for (size_t i = 0; i < count; i++)
    if (get_output_derivative(backend, index[i], order[i], &value[i])) return 1;
  return 0;
}

void flex_backend_summarise(flex_backend *backend, char *text, size_t size) {
  snprintf(text, size, "the trajectory was followed up to %.9g s", *backend->time);
}

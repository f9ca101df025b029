/* A trajectory behind the FMI layer; reals are the outputs: positions of all axes, velocities, accelerations. */
#include <stdio.h>

#include "backend.h"
#include "clock.h"
#include "memory.h"
#include "refusal.h"
#include "trajectory.h"

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

int flex_backend_has_model_exchange(void) {
  return 0;
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
  record->left = flex_trajectory_landing(&flex_the_trajectory, time, slack, FLEX_LEFT);
  record->right = flex_trajectory_landing(&flex_the_trajectory, time, slack, FLEX_RIGHT);
}

void flex_backend_reset(flex_backend *backend) {
  whole(backend)->record->limit = FLEX_LEFT;
  whole(backend)->record->passed = 0;
  go_to(whole(backend), 0.0, 0.0);
}

void flex_backend_restored(flex_backend *backend) {
  (void)backend;
}

void flex_backend_set_start_time(flex_backend *backend, double time) {
  go_to(whole(backend), time, flex_time_slack(time, 0.0));
}

double flex_backend_set_tolerance(flex_backend *backend, double tolerance) {
  (void)backend;
  return tolerance;
}

int flex_backend_begin(flex_backend *backend) {
  (void)backend;
  return 0;
}

int flex_backend_advance(flex_backend *backend, double t0, double t1, int *event) {
  double slack = flex_time_slack(t1, t1 - t0), next = flex_trajectory_next(&flex_the_trajectory, t0 + slack);
  if (event) *event = next <= t1 + slack;
  whole(backend)->record->passed = 0;
  go_to(whole(backend), event && next < t1 - slack ? next : t1, slack);
  return 0;
}

int flex_backend_handle_event(flex_backend *backend, int is_exchange, int *states_changed, double *next) {
  (void)is_exchange, (void)states_changed;
  whole(backend)->record->passed = 1;
  *next = flex_trajectory_next(&flex_the_trajectory, *backend->time + flex_time_slack(*backend->time, 0.0));
  return 0;
}

// an output or one of its derivatives, evaluated together with all others
static double signal(trajectory_backend *backend, int order, unsigned index) {
  const trajectory_record *record = backend->record, *shown = backend->shown;
  flex_limit limit = record->passed ? FLEX_RIGHT : (flex_limit)record->limit;
  double time = limit == FLEX_LEFT ? record->left : record->right;
  double shown_time = shown->limit == FLEX_LEFT ? shown->left : shown->right;
  if (!backend->is_evaluated || shown->limit != (int)limit || shown_time != time) {
    flex_trajectory_evaluate(&flex_the_trajectory, time, limit, backend->signals);
    *backend->shown = *record;
    backend->shown->limit = (int)limit;
    backend->is_evaluated = 1;
  }
  return backend->signals[(unsigned)(order * n_outputs()) + index];
}

int flex_backend_get_reals(flex_backend *backend, const unsigned *index, size_t count, double *value) {
  for (size_t i = 0; i < count; i++) {
    if (flex_refuse_reference(whole(backend)->message, index[i], n_outputs())) return 1;
    value[i] = signal(whole(backend), 0, index[i]);
  }
  return 0;
}

int flex_backend_set_real(flex_backend *backend, unsigned index, double value) {
  (void)value;
  char *message = whole(backend)->message;
  if (flex_refuse_reference(message, index, n_outputs())) return 1;
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
  char *message = whole(backend)->message;
  if (flex_refuse_reference(message, index, n_outputs())) return 1;
  if (order < 1 || order > FLEX_END_ORDER)
    return flex_refuse(message, "derivatives of %s are of order 1 to %d, got order %d",
                       flex_the_trajectory.output_variables[index].name, FLEX_END_ORDER, order);
  *value = signal(whole(backend), order, index);
  return 0;
}

int flex_backend_max_input_order(void) {
  return 0;
}

double flex_backend_input_derivative(const flex_backend *backend, unsigned input, int order) {
  return (void)backend, (void)input, (void)order, 0.0;
}

int flex_backend_get_output_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                        double *value) {
  for (size_t i = 0; i < count; i++)
    if (get_output_derivative(backend, index[i], order[i], &value[i])) return 1;
  return 0;
}

int flex_backend_differentiate(flex_backend *backend, const flex_direction *direction) {
  (void)direction;
  return flex_refuse(whole(backend)->message, "this FMU provides no directional derivatives, as its model description says");
}

void flex_backend_summarise(const flex_backend *backend, char *text, size_t size) {
  snprintf(text, size, "the trajectory was followed up to %.9g s", *backend->time);
}

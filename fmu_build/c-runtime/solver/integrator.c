/* From one communication point to the next: equal steps that fit between the two, planned anew where the error asks for another
 * size. Their times are start + i h, never a running sum. A budget of evaluations ends what would never end. */
#include "integrator.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "friction.h"
#include "integration_step.h"
#include "linear_algebra.h"

/* share of the tolerance that one step may use. The local error is held below share x tol^(q/p), q its order and p that of
 * the method: a step of the size that the error admits is proportional to tol^(1/p), so this is a constant error per unit of
 * time. */
#define LOCAL_SHARE 0.2

/* local errors below this multiple of the scale are rounding errors */
#define ROUNDING_ERROR (32.0 * DBL_EPSILON)

/* a longer step that the error admits is taken up in the middle of a communication step if it is so much longer */
#define REPLANNED_GROWTH 1.15

/* a step below this part of the communication step, or this many roundings of the time, cannot help; where sizes grow, the first
 * moments of a long communication step may take steps of many decades */
#define MIN_STEP_SHARE 1e-10
#define MIN_GROWING_STEP_SHARE 1e-18
#define MIN_STEP_ROUNDINGS 16.0

/* no importer can stop a communication step that has begun: after so many steps, some seconds, the importer gets a message */
#ifndef FLEX_MAX_STEPS
#define FLEX_MAX_STEPS 1000000.0
#endif

/* evaluations of the equations that may be made at the start, per communication step, however often it is repeated, and per
 * second of motion: a mode at 1 MHz takes no more, something that changes far faster than it matters does */
#ifndef FLEX_WORK_AT_START
#define FLEX_WORK_AT_START 1e6
#endif
#ifndef FLEX_WORK_PER_STEP
#define FLEX_WORK_PER_STEP 1e3
#endif
#ifndef FLEX_WORK_PER_SECOND
#define FLEX_WORK_PER_SECOND 4e7
#endif

/* a step looks so many communication steps ahead: inputs are extrapolated so far */
#define REACH 4.0

/* share of the tolerance by which extrapolated inputs may be off, relative to their size */
#define FORESEEN_SHARE 0.1

/* after inputs that were not foreseen so many times in a row, that power of 2 of communication points are ends of steps */
#define MOST_DROPS 10

/* numbers for each coordinate: of a step that can be interpolated, and of the motion at a point (y, v, their rests, a) */
#define SEGMENT (FLEX_DENSE_NODES + 2)
#define MOTION 5

void flex_integrator_take_state(flex_integrator *integrator, const flex_model *model, flex_arena *arena) {
  int n = model->n;
  size_t size = (size_t)n;
  integrator->n = n;
  integrator->motion_count = (7 + FLEX_MAX_STAGES + size) * size;
  real *motion = flex_take_reals(arena, integrator->motion_count);
  if (motion) {
    integrator->y = motion;
    integrator->v = integrator->y + n;
    integrator->y_rest = integrator->v + n;
    integrator->v_rest = integrator->y_rest + n;
    integrator->a = integrator->v_rest + n;
    integrator->history = integrator->a + n;
    integrator->mass_factor = integrator->history + (FLEX_MAX_STAGES + 2) * n;
  }
  integrator->segments = flex_take_reals(arena, 2 * SEGMENT * size);
  integrator->far_motion = flex_take_reals(arena, MOTION * size);
  integrator->far_u = flex_take_reals(arena, (size_t)model->n_inputs);
  flex_stages_take_state(&integrator->stages, model, arena);
}

void flex_integrator_take_scratch(flex_integrator *integrator, int n, int n_inputs, flex_arena *arena) {
  size_t size = (size_t)n;
  integrator->saved = flex_take_reals(arena, integrator->motion_count);
  integrator->full_y = flex_take_reals(arena, size);
  integrator->full_v = flex_take_reals(arena, size);
  integrator->full_a = flex_take_reals(arena, (FLEX_MAX_STAGES + 1) * size);
  integrator->change = flex_take_reals(arena, 2 * size);
  integrator->defect = flex_take_reals(arena, size);
  integrator->end_u = flex_take_reals(arena, (size_t)n_inputs);
  integrator->explicit_y = flex_take_reals(arena, size);
  integrator->explicit_v = flex_take_reals(arena, FLEX_MAX_EXPLICIT_STAGES * size);
  integrator->explicit_a = flex_take_reals(arena, FLEX_MAX_EXPLICIT_STAGES * size);
  flex_stages_take_scratch(&integrator->stages, n, n_inputs, arena);
}

// the method's step, compiled for lanes where the processor has them
static flex_step step_of(const flex_integrator *integrator, const flex_method *method) {
#if defined(FLEX_LANES) && FLEX_WIDTH == 1
  if (method->collocation && integrator->stages.equations->has_lanes) return flex_collocation_step_wide;
#else
  (void)integrator;
#endif
  return method->step;
}

void flex_integrator_use(flex_integrator *integrator, const flex_method *method, double tolerance) {
  double local = (method->looks_ahead ? 0.05 : LOCAL_SHARE) * pow(tolerance, method->local_order / (double)method->order);
  integrator->method = method;
  integrator->tolerance = tolerance;
  integrator->looks_ahead = FLEX_WIDTH == 1 && method->looks_ahead && flex_switches(integrator->stages.equations->model) == 0;
  integrator->step = step_of(integrator, method);
  integrator->local_error = fmax(local, ROUNDING_ERROR);
  if (method->collocation) flex_stages_use(&integrator->stages, method->collocation);
}

void flex_integrator_start(flex_integrator *integrator) {
  flex_integrator_record *record = integrator->record;
  size_t size = (size_t)integrator->n * sizeof(real);
  memset(integrator->y_rest, 0, size);
  memset(integrator->v_rest, 0, size);
  integrator->work_left = FLEX_WORK_AT_START;
  record->step = 0.0;
  record->is_ahead = record->patience = record->drops = 0;
  flex_step_grow_sizes(integrator);
  record->scale = flex_larger(*integrator->floor, flex_motion_norm(&integrator->stages, integrator->y, integrator->v));
  flex_step_restart(integrator);
}

flex_outcome flex_integrator_factor(flex_integrator *integrator, const real *u) {
  return integrator->n == 0 || integrator->record->is_factored ? FLEX_DONE : flex_step_factor(integrator, integrator->y, u);
}

// a step in which the motion changes by about its own size, for lack of anything better
static double first_step(const flex_integrator *integrator, double span) {
  double scale = flex_common(integrator->record->scale);
  double change = flex_error_norm(&integrator->stages, integrator->v, integrator->a, integrator->record->scale);
  return change * span > scale ? scale / change : span;
}

// a rigid model has nothing to integrate
static flex_failure advance_rigid(flex_integrator *integrator, double t0, double t1) {
  flex_failure result = {FLEX_DONE, t0, 0.0};
  flex_inputs_evaluate(integrator->stages.inputs, t1, 0.0, integrator->end_u);
  result.outcome = flex_step_check_margin(integrator, integrator->end_u, &result.value);
  if (result.outcome != FLEX_DONE) return result;
  result.time = t1;
  integrator->record->steps++;
  return result;
}

// equal steps towards t1 until one fails or another size is called for; how far they came is in result->time
static flex_outcome make_steps(flex_integrator *integrator, double t1, long long last, double *attempts,
                               flex_failure *result) {
  flex_integrator_record *record = integrator->record;
  double start = result->time, remaining = t1 - start, fixed = *integrator->fixed_step;
  double count = fmax(1.0, ceil(remaining / record->step * (1.0 - 1e-9)));
  double h = remaining / count, taken = h;
  int has_events = FLEX_WIDTH == 1 && flex_switches(integrator->stages.equations->model) > 0;
  integrator->wants_longer_steps = count > 1.0;

  // their times are start + i h
  for (double i = 0.0; i < count; i += 1.0) {
    if ((*attempts)++ >= FLEX_MAX_STEPS) {
      result->value = FLEX_MAX_STEPS;
      return FLEX_TOO_MANY_STEPS;
    }
    // a fixed step is work that was asked for
    if (fixed == 0.0 && *integrator->stages.equations->evaluations > last) {
      result->value = FLEX_WORK_PER_SECOND;
      return FLEX_TOO_MUCH_WORK;
    }

    // one step; with friction or events it may end earlier, at an event
    double allowed = integrator->local_error * flex_common(record->scale);
    flex_outcome outcome =
        has_events ? flex_friction_step(integrator, start + i * h, &taken, allowed, attempts, &result->value)
                     : integrator->step(integrator, start + i * h, h, allowed, &result->value);
    if (outcome != FLEX_DONE) return outcome;

    // the last one ends at t1 exactly; an event or another step size makes a new plan
    result->time = taken < h ? start + i * h + taken : i + 1.0 == count ? t1 : start + (i + 1.0) * h;
    if (integrator->completed) integrator->completed(integrator, result->time);
    if (fixed > 0.0) record->step = fixed;
    if (taken < h || record->at_event || (fixed == 0.0 && (record->step < h || record->step > REPLANNED_GROWTH * h))) break;
  }
  return FLEX_DONE;
}

// a fixed step can't be made smaller: what goes wrong is its fault, unless the mechanism itself is at its limits
static flex_failure fixed_step_failure(flex_integrator *integrator, flex_failure failure) {
  integrator->record->step = 0.0;
  if (failure.outcome != FLEX_NOT_FINITE && failure.outcome != FLEX_NO_CONVERGENCE) return failure;
  flex_failure blamed = {FLEX_STEP_TOO_LONG, failure.time, *integrator->fixed_step};
  return blamed;
}

static flex_failure advance(flex_integrator *integrator, double t0, double t1, long long last) {
  flex_integrator_record *record = integrator->record;
  flex_failure result = {FLEX_DONE, t0, 0.0};
  double attempts = 0.0, span = t1 - t0, fixed = *integrator->fixed_step;
  double share = integrator->stages.equations->model->sizes_grow ? MIN_GROWING_STEP_SHARE : MIN_STEP_SHARE;
  double least = fmax(share * span, MIN_STEP_ROUNDINGS * DBL_EPSILON * fmax(fabs(t0), fabs(t1)));

  // first guess of the step size
  if (fixed > 0.0)
    record->step = fixed;
  else if (record->step == 0.0)
    record->step = first_step(integrator, span);

  // sequences of equal steps up to t1
  while (result.time < t1 && !record->at_event) {
    result.outcome = make_steps(integrator, t1, last, &attempts, &result);
    if (result.outcome == FLEX_DONE) continue;
    if (result.outcome == FLEX_TOO_MANY_STEPS || result.outcome == FLEX_TOO_MUCH_WORK) return result;
    if (fixed > 0.0) return fixed_step_failure(integrator, result);

    // a step too small to help: what went wrong is reported
    if (record->step < least) {
      record->step = 0.0;
      return result;
    }
  }
  result.outcome = FLEX_DONE;
  return result;
}

// the motion at a time within one of the last two steps, by the polynomial through the accelerations at start and stages and its
// integrals; these meet the step's end, since the quadrature is exact for them (Hairer and Wanner II, section IV.8)
static void interpolate_step(flex_integrator *integrator, double time) {
  const flex_integrator_record *record = integrator->record;
  int n = integrator->n, k = time < record->begin[0];
  double h = record->length[k], x = (time - record->begin[k]) / h, weights[3][FLEX_DENSE_NODES] = {{0.0}};
  const real *start = integrator->segments + k * SEGMENT * n, *accelerations = start + 2 * n;
  for (int j = 0; j < FLEX_DENSE_NODES; j++)
    for (int i = FLEX_DENSE_NODES - 1; i >= 0; i--) {
      double c = integrator->stages.tableau->between[j][i];
      weights[0][j] = weights[0][j] * x + c;
      weights[1][j] = weights[1][j] * x + c / (i + 1) * (x * h);
      weights[2][j] = weights[2][j] * x + c / ((i + 1) * (i + 2)) * (x * x * h * h);
    }
  flex_combine(n, FLEX_DENSE_NODES, weights[0], accelerations, integrator->a);
  flex_combine(n, FLEX_DENSE_NODES, weights[1], accelerations, integrator->v);
  flex_combine(n, FLEX_DENSE_NODES, weights[2], accelerations, integrator->y);
  for (int c = 0; c < n; c++) {
    integrator->y[c] = start[c] + (x * h * start[n + c] + integrator->y[c]);
    integrator->v[c] += start[n + c];
    integrator->y_rest[c] = integrator->v_rest[c] = flex_real(0.0);
  }
  integrator->record->is_factored = 0;
}

void flex_integrator_keep_segment(flex_integrator *integrator, double t, double h) {
  flex_integrator_record *record = integrator->record;
  size_t n = (size_t)integrator->n;
  real *segment = integrator->segments;
  memcpy(segment + SEGMENT * n, segment, SEGMENT * n * sizeof(real));
  memcpy(segment, integrator->y, 2 * n * sizeof(real));
  memcpy(segment + 2 * n, integrator->a, n * sizeof(real));
  memcpy(segment + 3 * n, integrator->stages.acceleration, (FLEX_DENSE_NODES - 1) * n * sizeof(real));
  record->begin[1] = record->begin[0], record->length[1] = record->length[0];
  record->begin[0] = t, record->length[0] = h;
}

void flex_integrator_drop(flex_integrator *integrator) {
  flex_integrator_record *record = integrator->record;
  if (!record->is_ahead) return;
  record->is_ahead = 0;
  record->history_step = 0.0;
  if (record->drops < MOST_DROPS) record->drops++;
  record->patience = 1 << record->drops;
  flex_accuracy_clear(&record->accuracy);
}

int flex_integrator_foresaw(flex_integrator *integrator, const real *before, const real *u) {
  const flex_inputs *inputs = integrator->stages.inputs;
  double share = FORESEEN_SHARE * integrator->tolerance;
  real *end_u = integrator->end_u;
  flex_inputs_evaluate(inputs, integrator->record->far, 0.0, end_u);
  for (int i = 0; i < inputs->count; i++) {
    real most = share * flex_larger(flex_fabs(before[i]), flex_larger(flex_fabs(integrator->far_u[i]), flex_fabs(end_u[i])));
    if (!flex_is_zero_or_more(most - flex_fabs(u[i] - before[i])) ||
        !flex_is_zero_or_more(most - flex_fabs(end_u[i] - integrator->far_u[i]))) {
      flex_integrator_drop(integrator);
      return 0;
    }
  }
  return 1;
}

// steps that go beyond t1 where they can, and the motion interpolated there; the rest of the way is left to `advance`
static double look_ahead(flex_integrator *integrator, double t0, double t1) {
  flex_integrator_record *record = integrator->record;
  size_t size = MOTION * (size_t)integrator->n * sizeof(real);
  double time = t0;

  if (record->is_ahead) time = record->far;
  if (record->is_ahead && time <= t1) {
    memcpy(integrator->y, integrator->far_motion, size);
    record->is_ahead = record->drops = 0;
  }
  if (record->patience > 0) {
    record->patience--;
    return time;
  }
  while (time < t1) {
    double h = fmin(record->step, REACH * (t1 - t0)), allowed = integrator->local_error * flex_common(record->scale), value;
    integrator->wants_longer_steps = 1;
    if (record->step < t1 - t0 || *integrator->fixed_step > 0.0) return time;
    if (integrator->step(integrator, time, h, allowed, &value) != FLEX_DONE) return time;
    time += h;
    if (time <= t1) continue;
    memcpy(integrator->far_motion, integrator->y, size);
    flex_inputs_evaluate(integrator->stages.inputs, time, 0.0, integrator->far_u);
    record->far = time;
    record->is_ahead = 1;
  }
  if (time > t1) interpolate_step(integrator, t1);
  return time;
}

flex_failure flex_integrator_advance(flex_integrator *integrator, double t0, double t1) {
  const long long *evaluations = integrator->stages.equations->evaluations;
  if (integrator->n == 0 && !integrator->completed) return advance_rigid(integrator, t0, t1);
  long long before = *evaluations;

  // the budget grows with the motion and shrinks with the work
  integrator->work_left += FLEX_WORK_PER_STEP + FLEX_WORK_PER_SECOND * (t1 - t0);
  double begin = integrator->looks_ahead ? look_ahead(integrator, t0, t1) : t0;
  flex_failure result = {FLEX_DONE, t1, 0.0};
  if (begin < t1) result = advance(integrator, begin, t1, before + (long long)fmin(integrator->work_left, 1e18));
  integrator->work_left -= (double)(*evaluations - before);
  return result;
}

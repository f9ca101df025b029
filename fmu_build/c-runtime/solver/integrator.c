/* From one communication point to the next: equal steps that fit between the two, planned anew where the error asks for another
 * size. Their times are start + i h, never a running sum. A budget of evaluations ends what would never end. */
#include "integrator.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "friction.h"
#include "integration_step.h"

/* share of the tolerance that one step may use. The local error is held below share x tol^(q/p), q its order and p that of
 * the method: a step of the size that the error admits is proportional to tol^(1/p), so this is a constant error per unit of
 * time. */
#define LOCAL_SHARE 0.2

/* local errors below this multiple of the scale are rounding errors */
#define ROUNDING_ERROR (32.0 * DBL_EPSILON)

/* a longer step that the error admits is taken up in the middle of a communication step if it is so much longer */
#define REPLANNED_GROWTH 1.15

/* a step below this part of the communication step, or this many roundings of the time, cannot help */
#define MIN_STEP_SHARE 1e-10
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

void flex_integrator_take_state(flex_integrator *integrator, int n, flex_arena *arena) {
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
  flex_stages_take_state(&integrator->stages, n, arena);
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
  double local = LOCAL_SHARE * pow(tolerance, method->local_order / (double)method->order);
  integrator->method = method;
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
  int has_friction = FLEX_WIDTH == 1 && integrator->stages.equations->model->n_frictions > 0;
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

    // one step; with friction it may end earlier, at an event
    double allowed = integrator->local_error * flex_common(record->scale);
    flex_outcome outcome =
        has_friction ? flex_friction_step(integrator, start + i * h, &taken, allowed, attempts, &result->value)
                     : integrator->step(integrator, start + i * h, h, allowed, &result->value);
    if (outcome != FLEX_DONE) return outcome;

    // the last one ends at t1 exactly; an event or another step size makes a new plan
    result->time = taken < h ? start + i * h + taken : i + 1.0 == count ? t1 : start + (i + 1.0) * h;
    if (fixed > 0.0) record->step = fixed;
    if (taken < h || (fixed == 0.0 && (record->step < h || record->step > REPLANNED_GROWTH * h))) break;
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
  double least = fmax(MIN_STEP_SHARE * span, MIN_STEP_ROUNDINGS * DBL_EPSILON * fmax(fabs(t0), fabs(t1)));

  // first guess of the step size
  if (fixed > 0.0)
    record->step = fixed;
  else if (record->step == 0.0)
    record->step = first_step(integrator, span);

  // sequences of equal steps up to t1
  while (result.time < t1) {
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

flex_failure flex_integrator_advance(flex_integrator *integrator, double t0, double t1) {
  if (integrator->n == 0) return advance_rigid(integrator, t0, t1);
  const long long *evaluations = integrator->stages.equations->evaluations;
  long long before = *evaluations;

  // the budget grows with the motion and shrinks with the work
  integrator->work_left += FLEX_WORK_PER_STEP + FLEX_WORK_PER_SECOND * (t1 - t0);
  flex_failure result = advance(integrator, t0, t1, before + (long long)fmin(integrator->work_left, 1e18));
  integrator->work_left -= (double)(*evaluations - before);
  return result;
}

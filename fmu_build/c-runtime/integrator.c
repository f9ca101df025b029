#include "integrator.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "linear_algebra.h"
#include "prediction.h"

/* share of the tolerance that one step may use. The local error is held below share x tol^(1 + 1/(2 s)): a step of the
 * size that the error admits is proportional to tol^(1/(2 s)), so this is a constant error per unit of time. */
#define LOCAL_SHARE 0.2

/* share of the local error that unfinished Newton iterations may use. What they leave drives stiff modes without damping
 * step by step: with 0.01 these rang so loudly after 10^4 steps that they had to be resolved, at six times the cost */
#define NEWTON_SHARE 0.001

/* local errors below this multiple of the scale are rounding errors */
#define ROUNDING_ERROR (32.0 * DBL_EPSILON)

/* the cheap estimate: weights of the defect at the start of a step in the rates (times h) and the positions (times h^2);
 * their size hardly matters, since calibration finds what they are worth */
#define DEFECT_RATE 0.2
#define DEFECT_POSITION 0.05

/* step after one whose equations could not be solved */
#define FAILED_SHRINK 0.3

/* least shrinking of a step that was too inaccurate, and of one that two halves could not save */
#define INACCURATE_SHRINK 0.9
#define HALVED_SHRINK 0.5

/* a longer step that the error admits is taken up in the middle of a communication step if it is so much longer */
#define REPLANNED_GROWTH 1.15

/* a step below this part of the communication step, or this many roundings of the time, cannot help */
#define MIN_STEP_SHARE 1e-10
#define MIN_STEP_ROUNDINGS 16.0

/* no importer can stop a communication step that has begun: after so many steps, some seconds, it is told */
#ifndef FLEX_MAX_STEPS
#define FLEX_MAX_STEPS 1000000.0
#endif

void flex_integrator_take_state(flex_integrator *integrator, int n, flex_arena *arena) {
  size_t size = (size_t)n;
  integrator->n = n;
  integrator->motion_count = (7 + FLEX_MAX_STAGES + size) * size;
  double *motion = flex_take_doubles(arena, integrator->motion_count);
  if (motion) {
    integrator->y = motion;
    integrator->v = integrator->y + n;
    integrator->y_rest = integrator->v + n;
    integrator->v_rest = integrator->y_rest + n;
    integrator->a = integrator->v_rest + n;
    integrator->start_a = integrator->a + n;
    integrator->end_a = integrator->start_a + n;
    integrator->stage_a = integrator->end_a + n;
    integrator->mass_factor = integrator->stage_a + FLEX_MAX_STAGES * n;
  }
  flex_stages_take_state(&integrator->stages, n, arena);
}

void flex_integrator_take_scratch(flex_integrator *integrator, int n, int n_inputs, flex_arena *arena) {
  size_t size = (size_t)n;
  integrator->saved = flex_take_doubles(arena, integrator->motion_count);
  integrator->full_y = flex_take_doubles(arena, size);
  integrator->full_v = flex_take_doubles(arena, size);
  integrator->full_a = flex_take_doubles(arena, FLEX_MAX_STAGES * size);
  integrator->defect = flex_take_doubles(arena, size);
  integrator->end_u = flex_take_doubles(arena, (size_t)n_inputs);
  flex_stages_take_scratch(&integrator->stages, n, n_inputs, arena);
}

void flex_integrator_start(flex_integrator *integrator) {
  flex_integrator_record *record = integrator->record;
  size_t size = (size_t)integrator->n * sizeof(double);
  memset(integrator->y_rest, 0, size);
  memset(integrator->v_rest, 0, size);
  record->step = 0.0;
  record->history_step = 0.0;
  record->scale = fmax(*integrator->floor, flex_motion_norm(&integrator->stages, integrator->y, integrator->v));
  flex_accuracy_clear(&record->accuracy);
  flex_stages_clear(&integrator->stages);
}

flex_outcome flex_integrator_accelerate(flex_integrator *integrator, const double *u) {
  int n = integrator->n;
  if (n == 0) return FLEX_DONE;

  // M a = -b by one correction of the present a: r(a) = M a + b
  double *r = integrator->defect;
  if (flex_mass_matrix(integrator->stages.equations, integrator->y, u, integrator->mass_factor)) return FLEX_NOT_FINITE;
  if (flex_residual(integrator->stages.equations, integrator->y, integrator->v, integrator->a, u, r)) return FLEX_NOT_FINITE;
  double sum = 0.0;
  for (int i = 0; i < n * n; i++) sum += integrator->mass_factor[i];
  if (!isfinite(sum)) return FLEX_NOT_FINITE;
  if (flex_cholesky_factor(n, integrator->mass_factor)) return FLEX_NOT_DEFINITE;
  flex_cholesky_solve(n, integrator->mass_factor, r);

  // a correction that is no number must not spoil the next attempt
  sum = 0.0;
  for (int i = 0; i < n; i++) sum += r[i];
  if (!isfinite(sum)) return FLEX_NOT_FINITE;
  for (int i = 0; i < n; i++) integrator->a[i] -= r[i];
  return FLEX_DONE;
}

// prediction from the last step, shifted by the jump of the acceleration at the present time
static void predict_from_history(flex_integrator *integrator, double h) {
  const flex_history history = {integrator->start_a, integrator->stage_a, integrator->end_a};
  int n = integrator->n, s = integrator->stages.tableau->stages;
  double *a = integrator->stages.acceleration;
  if (integrator->record->history_step == 0.0) {
    for (int i = 0; i < s; i++) memcpy(a + i * n, integrator->a, (size_t)n * sizeof *a);
    return;
  }
  flex_predict(n, integrator->stages.tableau, &history, 1.0, h / integrator->record->history_step, a);
  for (int i = 0; i < s; i++)
    for (int c = 0; c < n; c++) a[i * n + c] += integrator->a[c] - integrator->end_a[c];
}

// what the prediction missed for its reach: a high derivative of the motion, which jumps where one of the inputs does
static double bend(const flex_integrator *integrator, double h) {
  double history = integrator->record->history_step;
  if (history == 0.0) return HUGE_VAL;
  return integrator->stages.record->misprediction / (h * flex_prediction_reach(integrator->stages.tableau, history, h));
}

// x + dx with the rounding error kept in rest (Knuth's two-sum)
static void add_compensated(double *x, double *rest, double dx) {
  double increment = dx + *rest, sum = *x + increment;
  double back = sum - *x;
  *rest = (*x - (sum - back)) + (increment - back);
  *x = sum;
}

// change of position and rate over a step
static void step_increment(const flex_integrator *integrator, double h, int c, double *dy, double *dv) {
  const flex_tableau *tableau = integrator->stages.tableau;
  const double *a = integrator->stages.acceleration + c;
  double position = 0.0, rate = 0.0;
  for (int i = 0; i < tableau->stages; i++) {
    position += tableau->b_position[i] * a[i * integrator->n];
    rate += tableau->b[i] * a[i * integrator->n];
  }
  *dy = h * integrator->v[c] + h * h * position;
  *dv = h * rate;
}

// the margin of the mechanism at the present position
static flex_outcome check_margin(flex_integrator *integrator, const double *u, double *margin) {
  const flex_model *model = integrator->stages.equations->model;
  if (flex_margin(integrator->stages.equations, integrator->y, u, margin)) return FLEX_NOT_FINITE;
  return *margin >= model->minimum_margin ? FLEX_DONE : FLEX_TOO_SINGULAR;
}

// moves on to the end of a step whose stages are solved
static flex_outcome finish(flex_integrator *integrator, double t, double h, double *margin) {
  flex_integrator_record *record = integrator->record;
  int n = integrator->n, s = integrator->stages.tableau->stages;
  size_t size = (size_t)n * sizeof(double);

  // end of the quadrature
  for (int c = 0; c < n; c++) {
    double dy, dv;
    step_increment(integrator, h, c, &dy, &dv);
    add_compensated(integrator->y + c, integrator->y_rest + c, dy);
    add_compensated(integrator->v + c, integrator->v_rest + c, dv);
  }

  // polynomial of this step, and its value at the end as first guess
  memcpy(integrator->start_a, integrator->a, size);
  memcpy(integrator->stage_a, integrator->stages.acceleration, (size_t)s * size);
  memset(integrator->a, 0, size);
  for (int i = 0; i < s; i++)
    for (int c = 0; c < n; c++) integrator->a[c] += integrator->stages.tableau->at_end[i] * integrator->stage_a[i * n + c];

  // acceleration at the end
  flex_inputs_evaluate(integrator->stages.inputs, t, h, integrator->end_u);
  flex_outcome outcome = flex_integrator_accelerate(integrator, integrator->end_u);
  if (outcome == FLEX_DONE) outcome = check_margin(integrator, integrator->end_u, margin);
  memcpy(integrator->end_a, integrator->a, size);
  record->history_step = h;
  record->scale = fmax(record->scale, flex_motion_norm(&integrator->stages, integrator->y, integrator->v));
  record->steps++;
  return outcome;
}

// solves the stages of a step, to a part of the local error that it may make
static flex_outcome solve(flex_integrator *integrator, double t, double h, double allowed) {
  const flex_integrator_record *record = integrator->record;
  double share = record->step > h ? h / record->step : 1.0;
  return flex_stages_solve(&integrator->stages, t, h, integrator->y, integrator->v, integrator->a, record->scale,
                           NEWTON_SHARE * share * allowed);
}

// the cheap estimate: acceleration at the start against the polynomial of the stages, without what stiff modes add
static double cheap_error(flex_integrator *integrator, double h) {
  const flex_tableau *tableau = integrator->stages.tableau;
  int n = integrator->n;
  double *defect = integrator->defect;
  for (int c = 0; c < n; c++) {
    double value = integrator->a[c];
    for (int i = 0; i < tableau->stages; i++) value -= tableau->at_start[i] * integrator->stages.acceleration[i * n + c];
    defect[c] = value;
  }
  flex_newton_filter(&integrator->stages.matrix, defect);
  double rate = DEFECT_RATE * h, position = DEFECT_POSITION * h * h, sum = 0.0;
  for (int c = 0; c < n; c++) {
    double weight = rate * rate * integrator->stages.rate_weight[c] + position * position * integrator->stages.position_weight[c];
    sum += weight * defect[c] * defect[c];
  }
  return sqrt(sum);
}

static void save(flex_integrator *integrator) {
  memcpy(integrator->saved, integrator->y, integrator->motion_count * sizeof(double));
}

// back to the start of a step, with a smaller one to come
static flex_outcome reject(flex_integrator *integrator, const flex_integrator_record *before, double step, flex_outcome outcome) {
  flex_integrator_record *record = integrator->record;
  memcpy(integrator->y, integrator->saved, integrator->motion_count * sizeof(double));
  long long rejections = record->rejections + 1;
  *record = *before;
  record->rejections = rejections;
  record->step = step;
  record->accuracy.sharpness = 0.0;
  return outcome;
}

// two steps of half the size, predicted by the full step
static flex_outcome take_halves(flex_integrator *integrator, double t, double h, double allowed, double *value) {
  const flex_history full = {integrator->saved + (integrator->a - integrator->y), integrator->full_a, NULL};
  for (int half = 0; half < 2; half++) {
    double start = t + half * 0.5 * h;
    flex_predict(integrator->n, integrator->stages.tableau, &full, 0.5 * half, 0.5, integrator->stages.acceleration);
    flex_outcome outcome = solve(integrator, start, 0.5 * h, 0.5 * allowed);
    if (outcome == FLEX_DONE) outcome = finish(integrator, start, 0.5 * h, value);
    if (outcome != FLEX_DONE) return outcome;
  }
  return FLEX_DONE;
}

// one step, whose stages are solved, against two halves; the halves are kept
static flex_outcome calibrate(flex_integrator *integrator, const flex_integrator_record *before, double t, const flex_evidence *evidence,
                              double allowed, double *value) {
  flex_integrator_record *record = integrator->record;
  int n = integrator->n, s = integrator->stages.tableau->stages;
  double h = evidence->step;

  // result of the full step
  for (int c = 0; c < n; c++) {
    double dy, dv;
    step_increment(integrator, h, c, &dy, &dv);
    integrator->full_y[c] = integrator->y[c] + dy;
    integrator->full_v[c] = integrator->v[c] + dv;
  }
  memcpy(integrator->full_a, integrator->stages.acceleration, (size_t)(s * n) * sizeof(double));
  flex_outcome outcome = take_halves(integrator, t, h, allowed, value);
  if (outcome != FLEX_DONE) return reject(integrator, before, FAILED_SHRINK * h, outcome);

  // difference of the results = error of the full step, but for a factor 1 - 2^(-2 s)
  for (int c = 0; c < n; c++) {
    integrator->full_y[c] -= integrator->y[c];
    integrator->full_v[c] -= integrator->v[c];
  }
  double error = flex_error_norm(&integrator->stages, integrator->full_y, integrator->full_v);
  if (!isfinite(error)) return reject(integrator, before, FAILED_SHRINK * h, FLEX_NOT_FINITE);
  double fitting = flex_fitting_step(h, error, allowed, 2 * s + 1), halves_error = error / (ldexp(1.0, 2 * s) - 1.0);
  if (halves_error > allowed) {
    *value = halves_error / record->scale;
    return reject(integrator, before, flex_smaller_step(h, fitting, HALVED_SHRINK), FLEX_INACCURATE);
  }
  flex_accuracy_calibrate(&record->accuracy, evidence, error);
  record->step = flex_next_step(h, record->step, fitting);
  return FLEX_DONE;
}

// one step of size h, or two of half its size
static flex_outcome step(flex_integrator *integrator, double t, double h, double local, double *value) {
  flex_integrator_record *record = integrator->record;
  const flex_integrator_record before = *record;
  int s = integrator->stages.tableau->stages;
  double allowed = fmax(local, ROUNDING_ERROR) * record->scale;

  save(integrator);
  predict_from_history(integrator, h);
  flex_outcome outcome = solve(integrator, t, h, allowed);
  if (outcome != FLEX_DONE) return reject(integrator, &before, FAILED_SHRINK * h, outcome);

  // the cheap estimate alone is enough where it is small
  const flex_evidence evidence = {h, flex_accuracy_hold(&record->accuracy, s, cheap_error(integrator, h), h), bend(integrator, h)};
  int is_small = evidence.error <= allowed, applies = flex_accuracy_applies(&record->accuracy, &evidence);
  if (!is_small && !applies) return calibrate(integrator, &before, t, &evidence, allowed, value);

  // step size that would fit, by the better one of the two estimates
  double fitting = flex_fitting_step(h, evidence.error, allowed, s + 1);
  if (applies) {
    double error = flex_accuracy_error(&record->accuracy, s, &evidence);
    double sharp_fitting = flex_fitting_step(h, error, allowed, 2 * s + 1);
    *value = error / record->scale;
    if (!is_small && error > allowed)
      return reject(integrator, &before, flex_smaller_step(h, sharp_fitting, INACCURATE_SHRINK), FLEX_INACCURATE);
    fitting = fmax(fitting, sharp_fitting);
  }

  // on to the end of the step
  outcome = finish(integrator, t, h, value);
  if (outcome != FLEX_DONE) return reject(integrator, &before, FAILED_SHRINK * h, outcome);
  record->accuracy.age++;
  record->step = flex_next_step(h, record->step, fitting);
  return FLEX_DONE;
}

// a step in which the motion changes by about its own size, for lack of anything better
static double first_step(const flex_integrator *integrator, double span) {
  double change = flex_error_norm(&integrator->stages, integrator->v, integrator->a);
  return change * span > integrator->record->scale ? integrator->record->scale / change : span;
}

// a rigid model has nothing to integrate
static flex_failure advance_rigid(flex_integrator *integrator, double t0, double t1) {
  flex_failure result = {FLEX_DONE, t0, 0.0};
  flex_inputs_evaluate(integrator->stages.inputs, t1, 0.0, integrator->end_u);
  result.outcome = check_margin(integrator, integrator->end_u, &result.value);
  if (result.outcome != FLEX_DONE) return result;
  result.time = t1;
  integrator->record->steps++;
  return result;
}

flex_failure flex_integrator_advance(flex_integrator *integrator, double t0, double t1, double tolerance) {
  if (integrator->n == 0) return advance_rigid(integrator, t0, t1);
  flex_integrator_record *record = integrator->record;
  flex_failure result = {FLEX_DONE, t0, 0.0};
  double attempts = 0.0, span = t1 - t0, order = 2.0 * integrator->stages.tableau->stages;
  double least = fmax(MIN_STEP_SHARE * span, MIN_STEP_ROUNDINGS * DBL_EPSILON * fmax(fabs(t0), fabs(t1)));
  double local = LOCAL_SHARE * pow(tolerance, 1.0 + 1.0 / order);
  if (record->step == 0.0) record->step = first_step(integrator, span);

  while (result.time < t1) {
    // equal steps to the end; their times are start + i h
    double start = result.time, remaining = t1 - start;
    double count = fmax(1.0, ceil(remaining / record->step * (1.0 - 1e-9)));
    double h = remaining / count;
    for (double i = 0.0; i < count; i += 1.0) {
      if (attempts++ >= FLEX_MAX_STEPS) {
        result.outcome = FLEX_TOO_MANY_STEPS;
        result.value = FLEX_MAX_STEPS;
        return result;
      }
      result.outcome = step(integrator, start + i * h, h, local, &result.value);
      if (result.outcome != FLEX_DONE) break;
      result.time = i + 1.0 == count ? t1 : start + (i + 1.0) * h;
      if (record->step < h || record->step > REPLANNED_GROWTH * h) break;
    }

    // a step too small to help: what went wrong is reported
    if (result.outcome != FLEX_DONE && record->step < least) {
      record->step = 0.0;
      return result;
    }
  }
  result.outcome = FLEX_DONE;
  return result;
}

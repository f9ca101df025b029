#include "gauss.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "linear_algebra.h"

/* share of the tolerance that one step may use. The local error is held below share x tol^(1 + 1/(2 s)): a step of the
 * size that the error admits is proportional to tol^(1/(2 s)), so this is a constant error per unit of time. */
#define LOCAL_SHARE 0.2

/* share of the local error that unfinished Newton iterations may use */
#define NEWTON_SHARE 0.01

/* local errors below this multiple of the scale are rounding errors */
#define ROUNDING_ERROR (32.0 * DBL_EPSILON)

/* the cheap estimate: weights of the defect at the start of a step in the rates (times h) and the positions (times h^2) */
#define DEFECT_RATE 0.2
#define DEFECT_POSITION 0.05

/* decay of the cheap estimate per step where it passes through zero */
#define HOLD 0.7

/* the calibration is trusted for so many steps, so much growth of the cheap estimate and of the step */
#define CALIBRATION_STEPS 40
#define CALIBRATION_ERROR_GROWTH 3.0
#define CALIBRATION_STEP_GROWTH 1.25
#define CALIBRATION_BEND 4.0

/* step size control: aim below the tolerance, limits of a change, change that is worth new factors */
#define SAFETY 0.5
#define MAX_GROWTH 2.0
#define MIN_SHRINK 0.1
#define WORTHWHILE_GROWTH 1.15
#define FAILED_SHRINK 0.3

/* a step below this part of the communication step, or this many roundings of the time, cannot help */
#define MIN_STEP_SHARE 1e-10
#define MIN_STEP_ROUNDINGS 16.0

void flex_gauss_take_state(flex_gauss *gauss, int n, flex_arena *arena) {
  size_t size = (size_t)n;
  gauss->n = n;
  gauss->motion_count = (7 + FLEX_MAX_STAGES + size) * size;
  double *motion = flex_take_doubles(arena, gauss->motion_count);
  if (motion) {
    gauss->y = motion;
    gauss->v = gauss->y + n;
    gauss->y_rest = gauss->v + n;
    gauss->v_rest = gauss->y_rest + n;
    gauss->a = gauss->v_rest + n;
    gauss->start_a = gauss->a + n;
    gauss->end_a = gauss->start_a + n;
    gauss->stage_a = gauss->end_a + n;
    gauss->mass_factor = gauss->stage_a + FLEX_MAX_STAGES * n;
  }
  flex_stages_take_state(&gauss->stages, n, arena);
}

void flex_gauss_take_scratch(flex_gauss *gauss, int n, int n_inputs, flex_arena *arena) {
  size_t size = (size_t)n;
  gauss->saved = flex_take_doubles(arena, gauss->motion_count);
  gauss->full_y = flex_take_doubles(arena, size);
  gauss->full_v = flex_take_doubles(arena, size);
  gauss->full_a = flex_take_doubles(arena, FLEX_MAX_STAGES * size);
  gauss->defect = flex_take_doubles(arena, size);
  gauss->end_u = flex_take_doubles(arena, (size_t)n_inputs);
  flex_stages_take_scratch(&gauss->stages, n, n_inputs, arena);
}

static double motion_norm(const flex_gauss *gauss, const double *y, const double *v) {
  return flex_error_norm(gauss->n, gauss->stages.position_weight, gauss->stages.rate_weight, y, v);
}

void flex_gauss_start(flex_gauss *gauss) {
  flex_gauss_record *record = gauss->record;
  size_t size = (size_t)gauss->n * sizeof(double);
  memset(gauss->y_rest, 0, size);
  memset(gauss->v_rest, 0, size);
  record->step = 0.0;
  record->history_step = 0.0;
  record->held_error = 0.0;
  record->held_step = 1.0;
  record->sharpness = 0.0;
  record->scale = fmax(*gauss->floor, motion_norm(gauss, gauss->y, gauss->v));
  flex_stages_clear(&gauss->stages);
}

flex_outcome flex_gauss_accelerate(flex_gauss *gauss, const double *u) {
  int n = gauss->n;
  if (n == 0) return FLEX_DONE;

  // M a = -b by one correction of the present a: r(a) = M a + b
  double *r = gauss->defect;
  if (flex_mass_matrix(gauss->stages.equations, gauss->y, u, gauss->mass_factor)) return FLEX_NOT_FINITE;
  if (flex_residual(gauss->stages.equations, gauss->y, gauss->v, gauss->a, u, r)) return FLEX_NOT_FINITE;
  double sum = 0.0;
  for (int i = 0; i < n * n; i++) sum += gauss->mass_factor[i];
  if (!isfinite(sum)) return FLEX_NOT_FINITE;
  if (flex_cholesky_factor(n, gauss->mass_factor)) return FLEX_NOT_DEFINITE;
  flex_cholesky_solve(n, gauss->mass_factor, r);
  sum = 0.0;
  for (int i = 0; i < n; i++) {
    gauss->a[i] -= r[i];
    sum += gauss->a[i];
  }
  return isfinite(sum) ? FLEX_DONE : FLEX_NOT_FINITE;
}

// value at x of the polynomial through (nodes, values), added up into result [n]
static void interpolate(int n, int n_nodes, const double *nodes, const double *const *values, double x, double *result) {
  memset(result, 0, (size_t)n * sizeof *result);
  for (int j = 0; j < n_nodes; j++) {
    double above = 1.0, below = 1.0;
    for (int k = 0; k < n_nodes; k++)
      if (k != j) above *= x - nodes[k], below *= nodes[j] - nodes[k];
    double weight = above / below;
    for (int c = 0; c < n; c++) result[c] += weight * values[j][c];
  }
}

// stage accelerations at (first + c_i ratio), in units of the step of the polynomial that starts with start_a
static void predict(flex_gauss *gauss, const double *start_a, const double *stage_a, const double *end_a, double first,
                    double ratio) {
  const flex_tableau *tableau = gauss->stages.tableau;
  int n = gauss->n, s = tableau->stages, n_nodes = end_a ? s + 2 : s + 1;
  double nodes[FLEX_MAX_STAGES + 2];
  const double *values[FLEX_MAX_STAGES + 2];
  nodes[0] = 0.0;
  values[0] = start_a;
  for (int i = 0; i < s; i++) {
    nodes[i + 1] = tableau->c[i];
    values[i + 1] = stage_a + i * n;
  }
  nodes[s + 1] = 1.0;
  values[s + 1] = end_a;
  for (int i = 0; i < s; i++)
    interpolate(n, n_nodes, nodes, values, first + ratio * tableau->c[i], gauss->stages.acceleration + i * n);
}

// prediction from the last step, shifted by the jump of the acceleration at the present time
static void predict_from_history(flex_gauss *gauss, double h) {
  int n = gauss->n, s = gauss->stages.tableau->stages;
  double *a = gauss->stages.acceleration;
  if (gauss->record->history_step == 0.0) {
    for (int i = 0; i < s; i++) memcpy(a + i * n, gauss->a, (size_t)n * sizeof *a);
    return;
  }
  predict(gauss, gauss->start_a, gauss->stage_a, gauss->end_a, 1.0, h / gauss->record->history_step);
  for (int i = 0; i < s; i++)
    for (int c = 0; c < n; c++) a[i * n + c] += gauss->a[c] - gauss->end_a[c];
}

// x + dx with the rounding error kept in rest (Knuth's two-sum)
static void add_compensated(double *x, double *rest, double dx) {
  double increment = dx + *rest, sum = *x + increment;
  double back = sum - *x;
  *rest = (*x - (sum - back)) + (increment - back);
  *x = sum;
}

// change of position and rate over a step
static void step_increment(const flex_gauss *gauss, double h, int c, double *dy, double *dv) {
  const flex_tableau *tableau = gauss->stages.tableau;
  const double *a = gauss->stages.acceleration + c;
  double position = 0.0, rate = 0.0;
  for (int i = 0; i < tableau->stages; i++) {
    position += tableau->b_position[i] * a[i * gauss->n];
    rate += tableau->b[i] * a[i * gauss->n];
  }
  *dy = h * gauss->v[c] + h * h * position;
  *dv = h * rate;
}

// the margin of the mechanism at the present position
static flex_outcome check_margin(flex_gauss *gauss, const double *u, double *margin) {
  const flex_model *model = gauss->stages.equations->model;
  if (flex_margin(gauss->stages.equations, gauss->y, u, margin)) return FLEX_NOT_FINITE;
  return *margin >= model->minimum_margin ? FLEX_DONE : FLEX_TOO_SINGULAR;
}

// moves on to the end of a step whose stages are solved
static flex_outcome finish(flex_gauss *gauss, double t, double h, double *margin) {
  flex_gauss_record *record = gauss->record;
  int n = gauss->n, s = gauss->stages.tableau->stages;
  size_t size = (size_t)n * sizeof(double);

  // end of the quadrature
  for (int c = 0; c < n; c++) {
    double dy, dv;
    step_increment(gauss, h, c, &dy, &dv);
    add_compensated(gauss->y + c, gauss->y_rest + c, dy);
    add_compensated(gauss->v + c, gauss->v_rest + c, dv);
  }

  // polynomial of this step, and its value at the end as first guess
  memcpy(gauss->start_a, gauss->a, size);
  memcpy(gauss->stage_a, gauss->stages.acceleration, (size_t)s * size);
  memset(gauss->a, 0, size);
  for (int i = 0; i < s; i++)
    for (int c = 0; c < n; c++) gauss->a[c] += gauss->stages.tableau->at_end[i] * gauss->stage_a[i * n + c];

  // acceleration at the end
  flex_inputs_evaluate(gauss->stages.inputs, t, h, gauss->end_u);
  flex_outcome outcome = flex_gauss_accelerate(gauss, gauss->end_u);
  if (outcome == FLEX_DONE) outcome = check_margin(gauss, gauss->end_u, margin);
  memcpy(gauss->end_a, gauss->a, size);
  record->history_step = h;
  record->scale = fmax(record->scale, motion_norm(gauss, gauss->y, gauss->v));
  record->steps++;
  return outcome;
}

// solves the stages of a step, to a part of the local error that it may make
static flex_outcome solve(flex_gauss *gauss, double t, double h, double allowed) {
  const flex_gauss_record *record = gauss->record;
  double share = record->step > h ? h / record->step : 1.0;
  return flex_stages_solve(&gauss->stages, t, h, gauss->y, gauss->v, gauss->a, record->scale, NEWTON_SHARE * share * allowed);
}

// the cheap estimate: acceleration at the start against the polynomial of the stages, without what stiff modes add
static double cheap_error(flex_gauss *gauss, double h) {
  const flex_tableau *tableau = gauss->stages.tableau;
  int n = gauss->n;
  double *defect = gauss->defect;
  for (int c = 0; c < n; c++) {
    double value = gauss->a[c];
    for (int i = 0; i < tableau->stages; i++) value -= tableau->at_start[i] * gauss->stages.acceleration[i * n + c];
    defect[c] = value;
  }
  flex_stages_filter(&gauss->stages, defect);
  double rate = DEFECT_RATE * h, position = DEFECT_POSITION * h * h, sum = 0.0;
  for (int c = 0; c < n; c++) {
    double weight = rate * rate * gauss->stages.rate_weight[c] + position * position * gauss->stages.position_weight[c];
    sum += weight * defect[c] * defect[c];
  }
  return sqrt(sum);
}

// the cheap estimate bridged over its zeros
static double held_error(const flex_gauss *gauss, double error, double h) {
  const flex_gauss_record *record = gauss->record;
  double ratio = h / record->held_step;
  return fmax(error, HOLD * record->held_error * pow(fmin(ratio, 1.0), gauss->stages.tableau->stages + 1));
}

// what the prediction missed, divided by how far it reached out (error term of interpolation): a derivative of the motion
// that jumps where the inputs do
static double bend(const flex_gauss *gauss, double h) {
  const flex_tableau *tableau = gauss->stages.tableau;
  double history = gauss->record->history_step;
  if (history == 0.0) return HUGE_VAL;
  double x = 1.0 + h / history, reach = h * x * (x - 1.0);
  for (int i = 0; i < tableau->stages; i++) reach *= x - tableau->c[i];
  return gauss->stages.record->misprediction / (reach * pow(history, tableau->stages + 2));
}

// whether the last calibration says something about a step of size h with this cheap estimate
static int is_calibrated(const flex_gauss_record *record, double error, double bend, double h) {
  return record->sharpness > 0.0 && record->calibration_age < CALIBRATION_STEPS &&
         h <= CALIBRATION_STEP_GROWTH * record->calibration_step &&
         error <= CALIBRATION_ERROR_GROWTH * record->calibration_error && bend <= CALIBRATION_BEND * record->calibration_bend;
}

// calibrated estimate; the methods' orders differ by s
static double calibrated_error(const flex_gauss *gauss, double error, double h) {
  const flex_gauss_record *record = gauss->record;
  return error * record->sharpness * pow(h / record->calibration_step, gauss->stages.tableau->stages);
}

// step size for which an error of the given order meets what is allowed
static double fitting_step(double h, double error, double allowed, int order) {
  if (error <= 0.0) return HUGE_VAL;
  return h * pow(SAFETY * allowed / error, 1.0 / order);
}

// step size after a step that was taken; a step cut short by the communication step doesn't shrink it
static void suggest(flex_gauss_record *record, double h, double fitting) {
  int was_cut = h < 0.99 * record->step;
  double limited = fmin(fitting, MAX_GROWTH * h);
  if (was_cut)
    record->step = fmax(limited, fmin(record->step, fitting));
  else if (fitting < 0.9 * h || fitting > WORTHWHILE_GROWTH * h)
    record->step = fmax(limited, MIN_SHRINK * h);
  else
    record->step = h;
}

static void save(flex_gauss *gauss) {
  memcpy(gauss->saved, gauss->y, gauss->motion_count * sizeof(double));
}

// back to the start of a step, with a smaller one to come
static flex_outcome reject(flex_gauss *gauss, const flex_gauss_record *before, double step, flex_outcome outcome) {
  flex_gauss_record *record = gauss->record;
  memcpy(gauss->y, gauss->saved, gauss->motion_count * sizeof(double));
  long long rejections = record->rejections + 1;
  *record = *before;
  record->rejections = rejections;
  record->step = step;
  record->sharpness = 0.0;
  return outcome;
}

// one step against two halves; the halves are kept
static flex_outcome calibrate(flex_gauss *gauss, const flex_gauss_record *before, double t, double h, double error,
                              double bend, double allowed, double *value) {
  flex_gauss_record *record = gauss->record;
  const flex_tableau *tableau = gauss->stages.tableau;
  int n = gauss->n, order = 2 * tableau->stages + 1;

  // result of the full step
  for (int c = 0; c < n; c++) {
    double dy, dv;
    step_increment(gauss, h, c, &dy, &dv);
    gauss->full_y[c] = gauss->y[c] + dy;
    gauss->full_v[c] = gauss->v[c] + dv;
  }
  memcpy(gauss->full_a, gauss->stages.acceleration, (size_t)(tableau->stages * n) * sizeof(double));

  // two halves, predicted by the full step's polynomial
  for (int half = 0; half < 2; half++) {
    predict(gauss, gauss->saved + (gauss->a - gauss->y), gauss->full_a, NULL, 0.5 * half, 0.5);
    flex_outcome outcome = solve(gauss, t + half * 0.5 * h, 0.5 * h, 0.5 * allowed);
    if (outcome == FLEX_DONE) outcome = finish(gauss, t + half * 0.5 * h, 0.5 * h, value);
    if (outcome != FLEX_DONE) return reject(gauss, before, FAILED_SHRINK * h, outcome);
  }

  // difference of the results = error of the full step, but for a factor 1 - 2^(-2 s)
  for (int c = 0; c < n; c++) {
    gauss->full_y[c] -= gauss->y[c];
    gauss->full_v[c] -= gauss->v[c];
  }
  double full_error = motion_norm(gauss, gauss->full_y, gauss->full_v);
  double halves_error = full_error / (ldexp(1.0, 2 * tableau->stages) - 1.0);
  if (!isfinite(full_error)) return reject(gauss, before, FAILED_SHRINK * h, FLEX_NOT_FINITE);
  double fitting = fitting_step(h, full_error, allowed, order);
  if (halves_error > allowed) {
    *value = halves_error / record->scale;
    return reject(gauss, before, h * fmin(0.5, fmax(MIN_SHRINK, fitting / h)), FLEX_INACCURATE);
  }

  // what was learnt
  record->sharpness = fmin(1.0, full_error / error);
  record->calibration_step = h;
  record->calibration_error = error;
  record->calibration_bend = bend;
  record->calibration_age = 0;
  suggest(record, h, fitting);
  return FLEX_DONE;
}

// one step of size h, or two of half its size
static flex_outcome step(flex_gauss *gauss, double t, double h, double tolerance, double *value) {
  flex_gauss_record *record = gauss->record;
  const flex_gauss_record before = *record;
  int stages = gauss->stages.tableau->stages;
  double allowed = fmax(tolerance, ROUNDING_ERROR) * record->scale;

  save(gauss);
  predict_from_history(gauss, h);
  flex_outcome outcome = solve(gauss, t, h, allowed);
  if (outcome != FLEX_DONE) return reject(gauss, &before, FAILED_SHRINK * h, outcome);

  // estimates; the cheap one alone is enough where it is small
  double error = held_error(gauss, cheap_error(gauss, h), h);
  double missed = bend(gauss, h);
  int calibrated = is_calibrated(record, error, missed, h);
  record->held_error = error;
  record->held_step = h;
  if (error > allowed && !calibrated) return calibrate(gauss, &before, t, h, error, missed, allowed, value);
  double fitting = fitting_step(h, error, allowed, stages + 1);
  if (calibrated) {
    double sharp = calibrated_error(gauss, error, h);
    double sharp_fitting = fitting_step(h, sharp, allowed, 2 * stages + 1);
    if (sharp > allowed && error > allowed)
      return reject(gauss, &before, fmax(MIN_SHRINK * h, fmin(sharp_fitting, 0.9 * h)), FLEX_INACCURATE);
    fitting = fmax(fitting, sharp_fitting);
  }

  // on to the end of the step
  outcome = finish(gauss, t, h, value);
  if (outcome != FLEX_DONE) return reject(gauss, &before, FAILED_SHRINK * h, outcome);
  record->calibration_age++;
  suggest(record, h, fitting);
  return FLEX_DONE;
}

// a step in which the motion changes by about its own size, for lack of anything better
static double first_step(const flex_gauss *gauss, double span) {
  double change = motion_norm(gauss, gauss->v, gauss->a);
  return change * span > gauss->record->scale ? gauss->record->scale / change : span;
}

flex_failure flex_gauss_advance(flex_gauss *gauss, double t0, double t1, double tolerance) {
  flex_gauss_record *record = gauss->record;
  flex_failure result = {FLEX_DONE, t0, 0.0};
  double span = t1 - t0;
  double least = fmax(MIN_STEP_SHARE * span, MIN_STEP_ROUNDINGS * DBL_EPSILON * fmax(fabs(t0), fabs(t1)));

  // a rigid model has nothing to integrate
  if (gauss->n == 0) {
    flex_inputs_evaluate(gauss->stages.inputs, t1, 0.0, gauss->end_u);
    result.outcome = check_margin(gauss, gauss->end_u, &result.value);
    if (result.outcome == FLEX_DONE) result.time = t1, record->steps++;
    return result;
  }

  double order = 2.0 * gauss->stages.tableau->stages;
  double local = LOCAL_SHARE * pow(tolerance, 1.0 + 1.0 / order);
  if (record->step == 0.0) record->step = first_step(gauss, span);
  while (result.time < t1) {
    // equal steps to the end; their times are start + i h
    double start = result.time, remaining = t1 - start;
    double count = fmax(1.0, ceil(remaining / record->step * (1.0 - 1e-9)));
    double h = remaining / count;
    for (double i = 0.0; i < count; i += 1.0) {
      result.outcome = step(gauss, start + i * h, h, local, &result.value);
      if (result.outcome != FLEX_DONE) break;
      result.time = i + 1.0 == count ? t1 : start + (i + 1.0) * h;
      if (record->step < h || record->step > WORTHWHILE_GROWTH * h) break;
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

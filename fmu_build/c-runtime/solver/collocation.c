/* Steps of collocation methods: stages predicted from the last step's polynomial, solved by Newton's method, and accepted by a
 * cheap error estimate that is calibrated now and then by two steps of half the size (Hairer and Wanner, Solving Ordinary
 * Differential Equations II, section IV.8; Hairer, Norsett and Wanner I, section II.4 for the halves). */
#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "integration_step.h"
#include "linear_algebra.h"
#include "prediction.h"

/* share of the local error that unfinished Newton iterations may use. What they leave drives stiff modes step by step, which
 * only methods that end in a stage damp: the others let these ring so loudly after 10^4 steps of a share of 0.01 that they
 * had to be resolved, at six times the cost */
#define NEWTON_SHARE 0.001
#define DAMPED_NEWTON_SHARE 0.05

/* the cheap estimate: weights of the defect at the start of a step in the rates (times h) and the positions (times h^2);
 * their size hardly matters, since calibration finds what they are worth */
#define DEFECT_RATE 0.2
#define DEFECT_POSITION 0.05

/* so many steps after the last calibration one finds out whether the cheap estimate keeps steps too short, by a change of the
 * step size that lets stiff modes ring: only methods that end in a stage, and so damp these, can afford it */
#define MOST_CHEAP_STEPS 20

// prediction from the last step, shifted by the jump of the acceleration at the present time
static void predict_from_history(flex_integrator *integrator, double h) {
  const flex_history history = {integrator->history, 1};
  int n = integrator->n, s = integrator->stages.tableau->stages;
  const real *end_a = integrator->history + (s + 1) * n;
  real *a = integrator->stages.acceleration;

  // without a last step the acceleration stays as it is
  if (integrator->record->history_step == 0.0) {
    for (int i = 0; i < s; i++) memcpy(a + i * n, integrator->a, (size_t)n * sizeof *a);
    return;
  }

  // extrapolated, and moved to where the acceleration is now
  flex_predict(n, integrator->stages.tableau, &history, 1.0, h / integrator->record->history_step, a);
  for (int i = 0; i < s; i++)
    for (int c = 0; c < n; c++) a[i * n + c] += integrator->a[c] - end_a[c];
}

// what the prediction missed for its reach: a high derivative of the motion, which jumps where one of the inputs does
static double bend(const flex_integrator *integrator, double h) {
  double history = integrator->record->history_step;
  if (history == 0.0) return HUGE_VAL;
  return integrator->stages.record->misprediction / (h * flex_prediction_reach(integrator->stages.tableau, history, h));
}

// changes of positions and rates over a step, into the first and the second half of `change`
static void step_increments(flex_integrator *integrator, double step) {
  real h = flex_paced(step, integrator->stages.pace);
  const flex_tableau *tableau = integrator->stages.tableau;
  int n = integrator->n;
  real *dy = integrator->change, *dv = dy + n;
  flex_combine(n, tableau->stages, tableau->b_position, integrator->stages.acceleration, dy);
  flex_combine(n, tableau->stages, tableau->b, integrator->stages.acceleration, dv);
  for (int c = 0; c < n; c++) {
    dy[c] = h * integrator->v[c] + h * h * dy[c];
    dv[c] = h * dv[c];
  }
}

// acceleration at the end of a step, and whether the mechanism may be there: the last stage's, or from the polynomial's value
static flex_outcome accelerate_at_end(flex_integrator *integrator, double t, double h, double *margin) {
  const flex_stages *stages = &integrator->stages;
  int n = integrator->n, s = stages->tableau->stages;

  // the last stage is the end of the step
  if (flex_ends_in_stage(stages->tableau)) {
    memcpy(integrator->a, stages->acceleration + (s - 1) * n, (size_t)n * sizeof(real));
    integrator->record->is_factored = 0;
    return flex_step_check_margin(integrator, stages->u + (s - 1) * stages->inputs->count, margin);
  }

  // otherwise the polynomial predicts, and the equations at the end decide
  flex_combine(n, s, stages->tableau->at_end, stages->acceleration, integrator->a);
  flex_inputs_evaluate(stages->inputs, t, h, integrator->end_u);
  flex_outcome outcome = flex_step_accelerate_present(integrator, integrator->end_u);
  return outcome == FLEX_DONE ? flex_step_check_margin(integrator, integrator->end_u, margin) : outcome;
}

// moves on to the end of a step whose stages are solved
static flex_outcome finish(flex_integrator *integrator, double t, double h, double *margin) {
  flex_integrator_record *record = integrator->record;
  int n = integrator->n, s = integrator->stages.tableau->stages;
  size_t size = (size_t)n * sizeof(real);

  if (integrator->looks_ahead) flex_integrator_keep_segment(integrator, t, h);

  // end of the quadrature
  step_increments(integrator, h);
  for (int c = 0; c < n; c++) flex_step_move(integrator, c, integrator->change[c], integrator->change[n + c]);

  // polynomial of this step
  memcpy(integrator->history, integrator->a, size);
  memcpy(integrator->history + n, integrator->stages.acceleration, (size_t)s * size);

  flex_outcome outcome = accelerate_at_end(integrator, t, h, margin);
  memcpy(integrator->history + (s + 1) * n, integrator->a, size);
  record->history_step = h;
  flex_step_count(integrator);
  return outcome;
}

// solves the stages of a step, to a part of the local error that it may make
static flex_outcome solve(flex_integrator *integrator, double t, double h, double allowed) {
  const flex_integrator_record *record = integrator->record;
  double share = flex_ends_in_stage(integrator->stages.tableau) ? DAMPED_NEWTON_SHARE : NEWTON_SHARE;

  // a step that was cut short is solved to its part of what the whole one may leave
  if (record->step > h) share *= h / record->step;
  return flex_stages_solve(&integrator->stages, t, h, integrator->y, integrator->v, integrator->a, record->scale,
                           share * allowed);
}

// the cheap estimate: acceleration at the start against the polynomial of the stages, without what stiff modes add
static double cheap_error(flex_integrator *integrator, double step) {
  real h = flex_paced(step, integrator->stages.pace);
  const flex_tableau *tableau = integrator->stages.tableau;
  int n = integrator->n;
  real *defect = integrator->defect;

  // defect of the polynomial at the start, filtered so that stiff modes do not dominate it
  flex_combine(n, tableau->stages, tableau->at_start, integrator->stages.acceleration, defect);
  for (int c = 0; c < n; c++) defect[c] = integrator->a[c] - defect[c];
  flex_newton_filter(&integrator->stages.matrix, defect);

  // norm of the defect in rates and positions
  real rate = DEFECT_RATE * h, position = DEFECT_POSITION * h * h;
  real sum = flex_real(0.0);
  for (int c = 0; c < n; c++) {
    real of_rate = rate * rate * integrator->stages.rate_weight[c];
    real of_position = position * position * integrator->stages.position_weight[c];
    sum += (of_rate + of_position) * defect[c] * defect[c];
  }
  return flex_worst(flex_sqrt(sum), integrator->record->scale);
}

// two steps of half the size, predicted by the full step
static flex_outcome take_halves(flex_integrator *integrator, double t, double h, double allowed, double *value) {
  const flex_history full = {integrator->full_a, 0};
  for (int half = 0; half < 2; half++) {
    // stages predicted by the polynomial of the full step, solved to half the error each
    double start = t + half * 0.5 * h;
    flex_predict(integrator->n, integrator->stages.tableau, &full, 0.5 * half, 0.5, integrator->stages.acceleration);
    flex_outcome outcome = solve(integrator, start, 0.5 * h, 0.5 * allowed);
    if (outcome == FLEX_DONE) outcome = finish(integrator, start, 0.5 * h, value);
    if (outcome != FLEX_DONE) return outcome;
  }
  return FLEX_DONE;
}

// one step, whose stages are solved, against two halves; the halves are kept
static flex_outcome calibrate(flex_integrator *integrator, const flex_integrator_record *before, double t,
                              const flex_evidence *evidence, double allowed, double *value) {
  flex_integrator_record *record = integrator->record;
  int n = integrator->n, s = integrator->stages.tableau->stages, order = integrator->method->order;
  double h = evidence->step;

  // result of the full step
  step_increments(integrator, h);
  for (int c = 0; c < n; c++) {
    integrator->full_y[c] = integrator->y[c] + integrator->change[c];
    integrator->full_v[c] = integrator->v[c] + integrator->change[n + c];
  }
  memcpy(integrator->full_a, integrator->a, (size_t)n * sizeof(real));
  memcpy(integrator->full_a + n, integrator->stages.acceleration, (size_t)(s * n) * sizeof(real));

  // the same interval by two halves, which are kept
  flex_outcome outcome = take_halves(integrator, t, h, allowed, value);
  if (outcome != FLEX_DONE) return flex_step_reject(integrator, before, FLEX_FAILED_SHRINK * h, outcome);

  // difference of the results = error of the full step, but for a factor 1 - 2^-order
  for (int c = 0; c < n; c++) {
    integrator->full_y[c] -= integrator->y[c];
    integrator->full_v[c] -= integrator->v[c];
  }
  double error = flex_error_norm(&integrator->stages, integrator->full_y, integrator->full_v, record->scale);
  if (!isfinite(error)) return flex_step_reject(integrator, before, FLEX_FAILED_SHRINK * h, FLEX_NOT_FINITE);

  // the halves' own error decides; the full one says what the cheap estimate is worth. Shorter steps don't help against rounding
  if (error > allowed && error <= flex_step_rounding(integrator)) error = allowed;
  double fitting = flex_fitting_step(h, record->step, error, allowed, integrator->method->local_order);
  double halves_error = error / (ldexp(1.0, order) - 1.0);
  if (halves_error > allowed) {
    *value = halves_error / flex_common(record->scale);
    return flex_step_reject(integrator, before, flex_smaller_step(h, fitting, FLEX_HALVED_SHRINK), FLEX_INACCURATE);
  }
  flex_accuracy_calibrate(&record->accuracy, evidence, error);
  record->step = flex_next_step(h, record->step, fitting);
  return FLEX_DONE;
}

// whether the cheap estimate has kept steps short for long, maybe in vain
static int may_be_too_careful(const flex_integrator *integrator) {
  return integrator->wants_longer_steps && integrator->record->accuracy.age >= MOST_CHEAP_STEPS &&
         flex_ends_in_stage(integrator->stages.tableau);
}

// one step whose stages are solved, or two of half its size, as the error asks for
static flex_outcome control(flex_integrator *integrator, const flex_integrator_record *before, double t, double h,
                            double allowed, double *value) {
  flex_integrator_record *record = integrator->record;
  const flex_method *method = integrator->method;
  int s = method->collocation->stages;

  // the cheap estimate alone is enough where it is small
  double cheap = flex_accuracy_hold(&record->accuracy, s, cheap_error(integrator, h), h);
  const flex_evidence evidence = {h, cheap, bend(integrator, h)};
  int is_small = evidence.error <= allowed, applies = flex_accuracy_applies(&record->accuracy, &evidence);
  if (!applies && (!is_small || may_be_too_careful(integrator)))
    return calibrate(integrator, before, t, &evidence, allowed, value);

  // step size that would fit, by the better one of the two estimates
  double fitting = flex_fitting_step(h, record->step, evidence.error, allowed, s + 1);
  if (applies) {
    double error = flex_accuracy_error(&record->accuracy, method->local_order - (s + 1), &evidence);
    double sharp_fitting = flex_fitting_step(h, record->step, error, allowed, method->local_order);
    *value = error / flex_common(record->scale);
    if (!is_small && error > allowed) {
      double smaller = flex_smaller_step(h, sharp_fitting, FLEX_INACCURATE_SHRINK);
      return flex_step_reject(integrator, before, smaller, FLEX_INACCURATE);
    }
    fitting = fmax(fitting, sharp_fitting);
  } else {
    // where the cheap estimate stops being small, a calibration says what it is worth: it needn't be kept small
    fitting = fmax(fitting, h);
  }

  // on to the end of the step
  flex_outcome outcome = finish(integrator, t, h, value);
  if (outcome != FLEX_DONE) return flex_step_reject(integrator, before, FLEX_FAILED_SHRINK * h, outcome);
  record->accuracy.age++;
  record->step = flex_next_step(h, record->step, fitting);
  return FLEX_DONE;
}

flex_outcome flex_collocation_step(flex_integrator *integrator, double t, double h, double allowed, double *value) {
  // what a rejected step restores
  const flex_integrator_record before = *integrator->record;
  int is_fixed = *integrator->fixed_step > 0.0;

  // stages of the step
  flex_step_save(integrator);
  predict_from_history(integrator, h);
  flex_outcome outcome = solve(integrator, t, h, allowed);

  // error control, or with fixed steps straight to the end
  if (outcome == FLEX_DONE && !is_fixed) return control(integrator, &before, t, h, allowed, value);
  if (outcome == FLEX_DONE) outcome = finish(integrator, t, h, value);
  return outcome == FLEX_DONE ? outcome : flex_step_reject(integrator, &before, FLEX_FAILED_SHRINK * h, outcome);
}

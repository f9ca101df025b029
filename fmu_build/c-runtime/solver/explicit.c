/* Steps of explicit Runge-Kutta methods for y' = v, v' = a(t, y, v). The error is that of an embedded formula, or the difference
 * to two steps of half the size (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.4). */
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "integration_step.h"

/* h times the fastest rate of the equations from which a step of an explicit method may be unstable: less than the 2.8 of the
 * classical method and the 3.3 of Dormand and Prince on the negative axis, and about what they bear on the imaginary one */
#define UNSTABLE 2.0

// rates and accelerations of all stages of a step from the present y, v, a
static flex_outcome solve_stages(flex_integrator *integrator, double t, double h) {
  const flex_explicit_tableau *tableau = integrator->method->runge_kutta;
  int n = integrator->n;
  real *y = integrator->explicit_y, *v = integrator->explicit_v, *a = integrator->explicit_a;
  memcpy(v, integrator->v, (size_t)n * sizeof *v);
  memcpy(a, integrator->a, (size_t)n * sizeof *a);

  for (int i = 1; i < tableau->stages; i++) {
    // position and rate of the stage
    for (int c = 0; c < n; c++) {
      real dy = flex_real(0.0), dv = dy;
      for (int j = 0; j < i; j++) {
        dy += tableau->a[i][j] * v[j * n + c];
        dv += tableau->a[i][j] * a[j * n + c];
      }
      y[c] = integrator->y[c] + h * dy;
      v[i * n + c] = integrator->v[c] + h * dv;
    }

    // its acceleration, with that of the stage before as guess
    memcpy(a + i * n, a + (i - 1) * n, (size_t)n * sizeof *a);
    flex_inputs_evaluate(integrator->stages.inputs, t, tableau->c[i] * h, integrator->end_u);
    flex_outcome outcome = flex_step_accelerate(integrator, y, v + i * n, integrator->end_u, a + i * n);
    if (outcome != FLEX_DONE) return outcome;
  }
  return FLEX_DONE;
}

// h times the sum over the stages with the given weights, for one coordinate
static real weighted(const flex_integrator *integrator, const double *weights, const real *x, double h, int c) {
  real sum = flex_real(0.0);
  for (int i = 0; i < integrator->method->runge_kutta->stages; i++) sum += weights[i] * x[i * integrator->n + c];
  return h * sum;
}

// one step, its stages included
static flex_outcome take_step(flex_integrator *integrator, double t, double h, double *margin) {
  const flex_explicit_tableau *tableau = integrator->method->runge_kutta;
  int n = integrator->n;
  flex_outcome outcome = solve_stages(integrator, t, h);
  if (outcome != FLEX_DONE) return outcome;

  // end of the quadrature
  for (int c = 0; c < n; c++)
    flex_step_move(integrator, c, weighted(integrator, tableau->b, integrator->explicit_v, h, c),
                   weighted(integrator, tableau->b, integrator->explicit_a, h, c));

  // acceleration at the end
  memcpy(integrator->a, integrator->explicit_a + (tableau->stages - 1) * n, (size_t)n * sizeof(real));
  flex_inputs_evaluate(integrator->stages.inputs, t, h, integrator->end_u);
  if (!tableau->ends_last) outcome = flex_step_accelerate_present(integrator, integrator->end_u);
  if (outcome == FLEX_DONE) outcome = flex_step_check_margin(integrator, integrator->end_u, margin);
  return outcome;
}

/* h times the fastest rate of the equations, from two stages at one instant whose motions differ (Hairer and Wanner, Solving
 * Ordinary Differential Equations II, section IV.2); all stages must be known. Beyond a few units explicit steps are unstable */
static double speed(flex_integrator *integrator, double h) {
  const flex_explicit_tableau *tableau = integrator->method->runge_kutta;
  int n = integrator->n, first = tableau->stages - 1;
  while (first > 1 && tableau->c[first] != tableau->c[first - 1]) first--;
  const double *before = tableau->a[first - 1], *after = tableau->a[first];
  const real *rates = integrator->explicit_v, *accelerations = integrator->explicit_a;
  real *y = integrator->full_y, *v = integrator->full_v;

  // how far the motions of the stages are apart, then how much they change that in the step
  for (int c = 0; c < n; c++) {
    y[c] = v[c] = flex_real(0.0);
    for (int j = 0; j < first; j++) {
      y[c] += h * (after[j] - before[j]) * rates[j * n + c];
      v[c] += h * (after[j] - before[j]) * accelerations[j * n + c];
    }
  }
  double apart = flex_error_norm(&integrator->stages, y, v, integrator->record->scale);
  for (int c = 0; c < n; c++) {
    y[c] = h * (rates[first * n + c] - rates[(first - 1) * n + c]);
    v[c] = h * (accelerations[first * n + c] - accelerations[(first - 1) * n + c]);
  }
  return flex_error_norm(&integrator->stages, y, v, integrator->record->scale) / apart;
}

// error of the step that was taken, by the embedded method
static double embedded_error(flex_integrator *integrator, double h) {
  const double *weights = integrator->method->runge_kutta->b_error;
  for (int c = 0; c < integrator->n; c++) {
    integrator->full_y[c] = weighted(integrator, weights, integrator->explicit_v, h, c);
    integrator->full_v[c] = weighted(integrator, weights, integrator->explicit_a, h, c);
  }
  return flex_error_norm(&integrator->stages, integrator->full_y, integrator->full_v, integrator->record->scale);
}

// after a full step: the way again in two steps of half the size, which are kept; error: theirs
static flex_outcome take_explicit_halves(flex_integrator *integrator, double t, double h, double *error, double *margin) {
  size_t size = (size_t)integrator->n * sizeof(real);
  memcpy(integrator->full_y, integrator->y, size);
  memcpy(integrator->full_v, integrator->v, size);
  memcpy(integrator->y, integrator->saved, integrator->motion_count * sizeof(real));

  // from the saved start again
  for (int half = 0; half < 2; half++) {
    flex_outcome outcome = take_step(integrator, t + half * 0.5 * h, 0.5 * h, margin);
    if (outcome != FLEX_DONE) return outcome;
  }

  // difference of the results = error of the full step, but for a factor 1 - 2^-order
  for (int c = 0; c < integrator->n; c++) {
    integrator->full_y[c] -= integrator->y[c];
    integrator->full_v[c] -= integrator->v[c];
  }
  double difference = flex_error_norm(&integrator->stages, integrator->full_y, integrator->full_v, integrator->record->scale);
  *error = difference / (ldexp(1.0, integrator->method->order) - 1.0);
  return FLEX_DONE;
}

flex_outcome flex_explicit_step(flex_integrator *integrator, double t, double h, double allowed, double *value) {
  flex_integrator_record *record = integrator->record;
  const flex_integrator_record before = *record;
  double error = 0.0;

  // the step and its error
  flex_step_save(integrator);
  flex_outcome outcome = take_step(integrator, t, h, value);
  if (outcome == FLEX_DONE && *integrator->fixed_step == 0.0) {
    if (integrator->method->runge_kutta->is_embedded)
      error = embedded_error(integrator, h);
    else
      outcome = take_explicit_halves(integrator, t, h, &error, value);
  }
  // a motion that an unstable method blows up may pass a singularity, which isn't the mechanism's fault
  if (outcome == FLEX_TOO_SINGULAR && *integrator->fixed_step > 0.0 && !(speed(integrator, h) < UNSTABLE))
    outcome = FLEX_NO_CONVERGENCE;
  if (outcome == FLEX_DONE && !isfinite(error)) outcome = FLEX_NOT_FINITE;
  if (outcome != FLEX_DONE) return flex_step_reject(integrator, &before, FLEX_FAILED_SHRINK * h, outcome);

  // step size that would fit
  if (error > allowed && error <= flex_step_rounding(integrator)) error = allowed;
  double fitting = flex_fitting_step(h, record->step, error, allowed, integrator->method->local_order);
  if (error > allowed) {
    *value = error / flex_common(record->scale);
    return flex_step_reject(integrator, &before, flex_smaller_step(h, fitting, FLEX_INACCURATE_SHRINK), FLEX_INACCURATE);
  }
  flex_step_count(integrator);
  record->step = flex_next_step(h, record->step, fitting);
  return FLEX_DONE;
}

/* What all methods share: saving and restoring a step, moving on with compensated sums, and the acceleration M a = -b. */
#include "integration_step.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "linear_algebra.h"

void flex_step_save(flex_integrator *integrator) {
  memcpy(integrator->saved, integrator->y, integrator->motion_count * sizeof(real));
}

flex_outcome flex_step_reject(flex_integrator *integrator, const flex_integrator_record *before, double step,
                              flex_outcome outcome) {
  flex_integrator_record *record = integrator->record;
  memcpy(integrator->y, integrator->saved, integrator->motion_count * sizeof(real));
  long long rejections = record->rejections + 1;
  *record = *before;
  record->rejections = rejections;
  record->step = step;
  record->accuracy.sharpness = 0.0;
  return outcome;
}

double flex_step_rounding(flex_integrator *integrator) {
  const double digit = 2.0 * DBL_EPSILON;
  for (int c = 0; c < integrator->n; c++) {
    integrator->full_y[c] = digit * integrator->y[c];
    integrator->full_v[c] = digit * integrator->v[c];
  }
  return flex_error_norm(&integrator->stages, integrator->full_y, integrator->full_v, integrator->record->scale);
}

// x + dx with the rounding error kept in rest (Knuth's two-sum)
static void add_compensated(real *x, real *rest, real dx) {
  real increment = dx + *rest, sum = *x + increment;
  real back = sum - *x;
  *rest = (*x - (sum - back)) + (increment - back);
  *x = sum;
}

void flex_step_move(flex_integrator *integrator, int coordinate, real dy, real dv) {
  add_compensated(integrator->y + coordinate, integrator->y_rest + coordinate, dy);
  add_compensated(integrator->v + coordinate, integrator->v_rest + coordinate, dv);
}

static real sum_of(const real *x, int count) {
  real sum = flex_real(0.0);
  for (int i = 0; i < count; i++) sum += x[i];
  return sum;
}

// a mass matrix without a factor has entries that are no numbers, or isn't positive definite
static flex_outcome why_no_factor(flex_integrator *integrator, const real *y, const real *u) {
  int n = integrator->n;
  if (flex_mass_matrix(integrator->stages.equations, y, u, integrator->mass_factor)) return FLEX_NOT_FINITE;
  return flex_is_finite(sum_of(integrator->mass_factor, n * n)) ? FLEX_NOT_DEFINITE : FLEX_NOT_FINITE;
}

flex_outcome flex_step_factor(flex_integrator *integrator, const real *y, const real *u) {
  if (flex_mass_matrix(integrator->stages.equations, y, u, integrator->mass_factor)) return FLEX_NOT_FINITE;
  if (flex_cholesky_factor(integrator->n, integrator->mass_factor)) return why_no_factor(integrator, y, u);
  integrator->record->is_factored = 1;
  return FLEX_DONE;
}

flex_outcome flex_step_accelerate(flex_integrator *integrator, const real *y, const real *v, const real *u, real *a) {
  int n = integrator->n;
  if (n == 0) return FLEX_DONE;

  // M a = -b by one correction of the guess: r(a) = M a + b
  real *r = integrator->defect;
  flex_outcome outcome = flex_step_factor(integrator, y, u);
  if (outcome != FLEX_DONE) return outcome;
  if (flex_residual(integrator->stages.equations, y, v, a, u, r)) return FLEX_NOT_FINITE;
  flex_cholesky_solve(n, integrator->mass_factor, r);

  // a correction that is no number must not spoil the next attempt
  if (!flex_is_finite(sum_of(r, n))) return FLEX_NOT_FINITE;
  for (int i = 0; i < n; i++) a[i] -= r[i];
  return FLEX_DONE;
}

flex_outcome flex_step_check_margin(flex_integrator *integrator, const real *u, double *margin) {
  const flex_model *model = integrator->stages.equations->model;
  if (flex_margin(integrator->stages.equations, integrator->y, u, margin)) return FLEX_NOT_FINITE;
  return *margin >= model->minimum_margin ? FLEX_DONE : FLEX_TOO_SINGULAR;
}

// 1 / size^2 with a size of at least |x|, NaN where the square overflows; a coordinate without weight stays without one
static void grow_size(real *weight, real x) {
  *weight = flex_if_positive(*weight * x * x - flex_real(1.0), flex_real(1.0) / (x * x) + 0.0 * (x * x), *weight);
}

void flex_step_grow_sizes(flex_integrator *integrator) {
  if (!integrator->stages.equations->model->sizes_grow) return;
  for (int c = 0; c < integrator->n; c++) {
    grow_size(integrator->stages.position_weight + c, integrator->y[c]);
    grow_size(integrator->stages.rate_weight + c, integrator->v[c]);
  }
}

void flex_step_count(flex_integrator *integrator) {
  flex_integrator_record *record = integrator->record;
  flex_step_grow_sizes(integrator);
  record->scale = flex_larger(record->scale, flex_motion_norm(&integrator->stages, integrator->y, integrator->v));
  record->steps++;
}

void flex_step_restart(flex_integrator *integrator) {
  integrator->record->history_step = 0.0;
  flex_accuracy_clear(&integrator->record->accuracy);
  flex_stages_clear(&integrator->stages);
}

flex_outcome flex_step_accelerate_present(flex_integrator *integrator, const real *u) {
  return flex_step_accelerate(integrator, integrator->y, integrator->v, u, integrator->a);
}

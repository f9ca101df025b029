#include "statics.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "linear_algebra.h"

/* iterations: links are nearly linear springs, three are usual */
#define MAX_ITERATIONS 50

/* smallest damping factor */
#define LEAST_DAMPING 1e-4

/* a correction this small, relative to the deflection, is the last one; Newton's method squares it */
#define CONVERGED 1e-10

/* relative step of the difference quotients: forces are nearly linear, rounding errors of the stiffest links matter more */
#define DIFFERENCE 1e-4

void flex_statics_take(flex_statics *statics, int n, flex_arena *arena) {
  size_t size = (size_t)n;
  statics->zero = flex_take_doubles(arena, size);
  statics->trial = flex_take_doubles(arena, size);
  statics->residual = flex_take_doubles(arena, size);
  statics->correction = flex_take_doubles(arena, size);
  statics->simplified = flex_take_doubles(arena, size);
  statics->stiffness = flex_take_doubles(arena, size * size);
  statics->pivots = flex_take_ints(arena, size);
}

static double norm(int n, const double *weight, const double *x) {
  double sum = 0.0;
  for (int i = 0; i < n; i++) sum += weight[i] * x[i] * x[i];
  return sqrt(sum);
}

// stiffness dr/dy by differences, factorised
static int factor_stiffness(flex_statics *statics, flex_equations *equations, const double *weight, double scale,
                            const double *u, double *y) {
  int n = equations->model->n, refused = 0;
  for (int i = 0; i < n; i++) {
    double kept = y[i], size = weight[i] > 0.0 ? scale / sqrt(weight[i]) : 1.0;
    double *column = statics->stiffness + i * n;
    y[i] = kept + DIFFERENCE * fmax(size, fabs(kept));
    double step = y[i] - kept;
    refused |= flex_residual(equations, y, statics->zero, statics->zero, u, column);
    y[i] = kept;
    for (int k = 0; k < n; k++) column[k] = (column[k] - statics->residual[k]) / step;
  }
  return refused || flex_lu_factor(n, statics->stiffness, statics->pivots);
}

// correction of the present matrix for the residual at a point
static int correct(flex_statics *statics, flex_equations *equations, const double *u, const double *y, double *correction) {
  int n = equations->model->n;
  int refused = flex_residual(equations, y, statics->zero, statics->zero, u, statics->residual);
  memcpy(correction, statics->residual, (size_t)n * sizeof *correction);
  flex_lu_solve(n, statics->stiffness, statics->pivots, correction);
  return refused;
}

// largest damped step that makes the next correction smaller; 0 if there is none
static double damped_step(flex_statics *statics, flex_equations *equations, const double *weight, double size,
                          const double *u, const double *y) {
  int n = equations->model->n;
  for (double damping = 1.0; damping >= LEAST_DAMPING; damping *= 0.5) {
    for (int i = 0; i < n; i++) statics->trial[i] = y[i] - damping * statics->correction[i];
    if (correct(statics, equations, u, statics->trial, statics->simplified)) continue;
    if (norm(n, weight, statics->simplified) <= (1.0 - 0.25 * damping) * size) return damping;
  }
  return 0.0;
}

flex_outcome flex_statics_solve(flex_statics *statics, flex_equations *equations, const double *weight, double floor,
                                const double *u, double *y, double *last_correction) {
  int n = equations->model->n;
  if (n == 0) return FLEX_DONE;
  if (flex_residual(equations, y, statics->zero, statics->zero, u, statics->residual)) return FLEX_NOT_FINITE;

  for (int k = 0; k < MAX_ITERATIONS; k++) {
    // newton correction with a fresh matrix
    double scale = fmax(floor, norm(n, weight, y));
    if (factor_stiffness(statics, equations, weight, scale, u, y)) return FLEX_NOT_FINITE;
    memcpy(statics->correction, statics->residual, (size_t)n * sizeof *y);
    flex_lu_solve(n, statics->stiffness, statics->pivots, statics->correction);
    double size = norm(n, weight, statics->correction);
    *last_correction = size;
    if (!isfinite(size)) return FLEX_NOT_FINITE;

    // a tiny one is the last
    if (size <= CONVERGED * scale) {
      for (int i = 0; i < n; i++) y[i] -= statics->correction[i];
      return FLEX_DONE;
    }
    if (damped_step(statics, equations, weight, size, u, y) == 0.0) return FLEX_NO_EQUILIBRIUM;
    memcpy(y, statics->trial, (size_t)n * sizeof *y);
  }
  return FLEX_NO_EQUILIBRIUM;
}

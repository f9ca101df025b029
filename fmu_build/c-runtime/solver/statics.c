/* Damped Newton iterations with a fresh stiffness matrix each; the damping factor is halved until the natural monotonicity test
 * holds (source: statics.h). */
#include "statics.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "linear_algebra.h"

/* iterations: links are nearly linear springs, three are usual */
#define MAX_STATIC_ITERATIONS 50

/* smallest damping factor */
#define LEAST_DAMPING 1e-4

/* a correction this small, relative to the deflection, is the last one; Newton's method squares it */
#define CONVERGED 1e-10

/* relative step of the difference quotients: forces are nearly linear, rounding errors of the stiffest links matter more */
#define STATIC_DIFFERENCE 1e-4

void flex_statics_take(flex_statics *statics, int n, flex_arena *arena) {
  size_t size = (size_t)n;
  statics->zero = flex_take_reals(arena, size);
  statics->trial = flex_take_reals(arena, size);
  statics->residual = flex_take_reals(arena, size);
  statics->correction = flex_take_reals(arena, size);
  statics->simplified = flex_take_reals(arena, size);
  statics->stiffness = flex_take_reals(arena, size * size);
  statics->pivots = flex_take_ints(arena, size);
}

static real norm(int n, const real *weight, const real *x) {
  real sum = flex_real(0.0);
  for (int i = 0; i < n; i++) sum += weight[i] * x[i] * x[i];
  return flex_sqrt(sum);
}

int flex_statics_forces(flex_statics *statics, flex_equations *equations, const real *u, const real *y) {
  return flex_residual(equations, y, statics->zero, statics->zero, u, statics->residual);
}

// stiffness dr/dy of the free unknowns by differences, factorised
static int factor_static_stiffness(flex_statics *statics, flex_equations *equations, const real *weight, real scale,
                            const real *u, real *y) {
  int n = equations->model->n, locked = equations->model->n_locked, free = n - locked, refused = 0;
  const real *before = statics->residual;
  for (int i = 0; i < free; i++) {
    // one coordinate moves by a part of its own scale
    real *moved = y + locked + i, kept = *moved, share = weight[locked + i];
    real size = flex_if_positive(share, scale / flex_sqrt(share), flex_real(1.0));
    *moved = kept + STATIC_DIFFERENCE * flex_larger(size, flex_fabs(kept));
    real step = *moved - kept;
    refused |= flex_residual(equations, y, statics->zero, statics->zero, u, statics->simplified);
    *moved = kept;

    // column of the difference quotients
    for (int k = 0; k < free; k++)
      statics->stiffness[i * free + k] = (statics->simplified[locked + k] - before[locked + k]) / step;
  }
  return refused || flex_lu_factor(free, statics->stiffness, statics->pivots);
}

// correction of the present matrix for the residual at a point; locked unknowns stay
static int correct_pose(flex_statics *statics, flex_equations *equations, const real *u, const real *y, real *correction) {
  int n = equations->model->n, locked = equations->model->n_locked;
  int refused = flex_statics_forces(statics, equations, u, y);
  memset(correction, 0, (size_t)locked * sizeof *correction);
  memcpy(correction + locked, statics->residual + locked, (size_t)(n - locked) * sizeof *correction);
  flex_lu_solve(n - locked, statics->stiffness, statics->pivots, correction + locked);
  return refused;
}

// largest damped step that makes the next correction smaller; 0 if there is none
static double damped_step(flex_statics *statics, flex_equations *equations, const real *weight, real scale,
                          double size, const real *u, const real *y) {
  int n = equations->model->n;
  for (double damping = 1.0; damping >= LEAST_DAMPING; damping *= 0.5) {
    for (int i = 0; i < n; i++) statics->trial[i] = y[i] - damping * statics->correction[i];
    if (correct_pose(statics, equations, u, statics->trial, statics->simplified)) continue;
    if (flex_worst(norm(n, weight, statics->simplified), scale) <= (1.0 - 0.25 * damping) * size) return damping;
  }
  return 0.0;
}

flex_outcome flex_statics_solve(flex_statics *statics, flex_equations *equations, const real *weight, real floor,
                                const real *u, real *y, double *last_correction) {
  int n = equations->model->n, locked = equations->model->n_locked;
  if (n == locked) return FLEX_DONE;
  if (flex_statics_forces(statics, equations, u, y)) return FLEX_NOT_FINITE;

  for (int k = 0; k < MAX_STATIC_ITERATIONS; k++) {
    // newton correction with a fresh matrix
    real scale = flex_larger(floor, norm(n - locked, weight + locked, y + locked));
    if (factor_static_stiffness(statics, equations, weight, scale, u, y)) return FLEX_NOT_FINITE;
    memset(statics->correction, 0, (size_t)locked * sizeof *y);
    memcpy(statics->correction + locked, statics->residual + locked, (size_t)(n - locked) * sizeof *y);
    flex_lu_solve(n - locked, statics->stiffness, statics->pivots, statics->correction + locked);
    double size = flex_worst(norm(n, weight, statics->correction), scale);
    *last_correction = size;
    if (!isfinite(size)) return FLEX_NOT_FINITE;

    // a tiny one is the last
    if (size <= CONVERGED * flex_common(scale)) {
      for (int i = 0; i < n; i++) y[i] -= statics->correction[i];
      return FLEX_DONE;
    }

    // otherwise go as far as the next correction is smaller than this one
    if (damped_step(statics, equations, weight, scale, size, u, y) == 0.0) return FLEX_NO_EQUILIBRIUM;
    memcpy(y, statics->trial, (size_t)n * sizeof *y);
  }
  return FLEX_NO_EQUILIBRIUM;
}

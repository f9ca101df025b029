/* Newton's corrections of all stages side by side, for stages.c in lanes_collocation.c: the operations of each stage in their order,
 * and so the same bits. */
#ifndef FLEXFMU_LANES_CORRECTIONS_H
#define FLEXFMU_LANES_CORRECTIONS_H

#ifdef FLEX_IN_LANES
#include "lanes_stages.h"
#include "real.h"
#include "stages.h"

// between stages and lanes; a lane without a stage repeats the last one
static void spread_stages(const flex_stages *stages, const double *x, double *lanes) {
  int n = stages->n, s = stages->tableau->stages;
  for (int c = 0; c < n; c++)
    for (int i = 0; i < FLEX_MAX_STAGES; i++) lanes[FLEX_MAX_STAGES * c + i] = x[(i < s ? i : s - 1) * n + c];
}

static void collect_stages(const flex_stages *stages, const double *lanes, double *x) {
  int n = stages->n, s = stages->tableau->stages;
  for (int c = 0; c < n; c++)
    for (int i = 0; i < s; i++) x[i * n + c] = lanes[FLEX_MAX_STAGES * c + i];
}

// residuals of all stages, side by side; the operations of `move`
static void evaluate_lanes(flex_stages *stages, double h, const double *y, const double *v, const double *a, double *r) {
  int n = stages->n, s = stages->tableau->stages;
  double square = h * h, *q = stages->position, *w = stages->rate;
  flex_four drift = flex_load_four(stages->nodes) * h;
  for (int c = 0; c < n; c++, q += FLEX_MAX_STAGES, w += FLEX_MAX_STAGES) {
    flex_four position = flex_mix_lanes(s, stages->to_position, a + FLEX_MAX_STAGES * c);
    flex_four rate = flex_mix_lanes(s, stages->to_rate, a + FLEX_MAX_STAGES * c);
    flex_store_four(q, y[c] + (drift * v[c] + square * position));
    flex_store_four(w, v[c] + h * rate);
  }
  flex_residual_lanes(stages->equations, s, stages->position, stages->rate, a,
                      stages->u + FLEX_MAX_STAGES * stages->inputs->count, r);
}

// one correction of all stages, side by side; returns its size
static double correct_lanes(flex_stages *stages, double h, const double *y, const double *v, double scale) {
  double *a = stages->lanes, *x = a + FLEX_MAX_STAGES * stages->n, sum = 0.0;
  evaluate_lanes(stages, h, y, v, a, x);
  flex_newton_solve_lanes(&stages->matrix, x);
  flex_four parts = {0.0};
  for (int c = 0; c < stages->n; c++, a += FLEX_MAX_STAGES, x += FLEX_MAX_STAGES) {
    flex_four each = flex_load_four(x);
    flex_store_four(a, flex_load_four(a) - each);
    parts += stages->weight[c] * each * each;
  }
  for (int i = 0; i < stages->tableau->stages; i++) sum += stages->tableau->b[i] * parts[i];
  return flex_worst(flex_sqrt(sum), scale);
}
#endif

#endif

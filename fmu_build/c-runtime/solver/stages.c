/* Simplified Newton iterations for the stages of a collocation step. The matrix is kept over many steps; how fast corrections
 * shrink says when iterations may end and when the matrix is worn (Hairer and Wanner, Solving Ordinary Differential Equations
 * II, section IV.8: stopping criterion and reuse of the Jacobian). */
#include "stages.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"

#include "lanes_corrections.h"
#include "linear_algebra.h"

/* iterations after which a step is given up: with a contraction of 0.3 all digits are there */
#define MAX_ITERATIONS 30

/* slowest contraction of a kept matrix, and the slowest that may go on at all */
#define WORN_CONTRACTION 0.3
#define HOPELESS_CONTRACTION 0.9

/* most that is expected of a contraction that was not measured: a second iteration becomes necessary and measures it */
#define MOST_EXPECTED 0.4

/* most that is believed of a contraction that ended in rounding errors */
#define MOST_ROUNDED 0.1

/* so often the mass matrix is renewed alone: it changes with the pose, while modal damping and stiffness hardly do */
#define MOST_RENEWALS 10

/* steps after which a second iteration measures the contraction, even if one was enough */
#define UNCHECKED_STEPS 8

/* rounding errors of the residual, in units of the machine precision times the size of what is summed; corrections up to
 * so many times that size are rounding errors if they stop contracting */
#define ROUNDING 8.0
#define STAGNATION 1e3

void flex_stages_take_state(flex_stages *stages, const flex_model *model, flex_arena *arena) {
  stages->n = model->n;
  flex_newton_take_state(&stages->matrix, model, arena);
}

void flex_stages_take_scratch(flex_stages *stages, int n, int n_inputs, flex_arena *arena) {
  size_t size = (size_t)(FLEX_MAX_STAGES * n);
  stages->acceleration = flex_take_reals(arena, size);
  stages->position = flex_take_reals(arena, size);
  stages->rate = flex_take_reals(arena, size);
  stages->residual = flex_take_reals(arena, size);
  stages->u = flex_take_reals(arena, (size_t)(2 * FLEX_MAX_STAGES * n_inputs));
  stages->lanes = flex_take_reals(arena, 2 * size);
  stages->weight = flex_take_reals(arena, (size_t)n);
  flex_newton_take_scratch(&stages->matrix, n, n_inputs, arena);
}

void flex_stages_use(flex_stages *stages, const flex_tableau *tableau) {
  stages->tableau = tableau;
  flex_newton_use(&stages->matrix, tableau);

  // by columns; a lane without a stage repeats the last one
  for (int lane = 0; lane < FLEX_MAX_STAGES; lane++) {
    int i = lane < tableau->stages ? lane : tableau->stages - 1;
    stages->nodes[lane] = tableau->c[i];
    for (int j = 0; j < tableau->stages; j++) {
      stages->to_position[j][lane] = tableau->a_squared[i][j];
      stages->to_rate[j][lane] = tableau->a[i][j];
    }
  }
}

void flex_stages_clear(flex_stages *stages) {
  flex_stages_record *record = stages->record;
  flex_newton_clear(&stages->matrix);
  record->contraction = 0.0;
  record->age = 0.0;
  record->excess_iterations = 0.0;
  record->usual_iterations = 0.0;
  record->fresh_steps = 0;
  record->unchecked_steps = UNCHECKED_STEPS;
}

real flex_motion_norm(const flex_stages *stages, const real *y, const real *v) {
  real sum = flex_real(0.0);
  for (int i = 0; i < stages->n; i++) sum += stages->rate_weight[i] * v[i] * v[i];
  for (int i = stages->equations->model->n_locked; i < stages->n; i++) sum += stages->position_weight[i] * y[i] * y[i];
  return flex_sqrt(sum);
}

double flex_error_norm(const flex_stages *stages, const real *dy, const real *dv, real scale) {
  real sum = flex_real(0.0);
  for (int i = 0; i < stages->n; i++)
    sum += stages->position_weight[i] * dy[i] * dy[i] + stages->rate_weight[i] * dv[i] * dv[i];
  return flex_worst(flex_sqrt(sum), scale);
}

// integrals of the accelerations in units of the step → positions and rates
static void move(int n, real h, real drift, const real *restrict y, const real *restrict v, real *restrict q,
                 real *restrict w) {
  real square = h * h;
  int c = 0;
  for (; c + 2 <= n; c += 2) {
    q[c] = y[c] + (drift * v[c] + square * q[c]);
    q[c + 1] = y[c + 1] + (drift * v[c + 1] + square * q[c + 1]);
    w[c] = v[c] + h * w[c];
    w[c + 1] = v[c + 1] + h * w[c + 1];
  }
  if (c == n) return;
  q[c] = y[c] + (drift * v[c] + square * q[c]);
  w[c] = v[c] + h * w[c];
}

// inputs of the stages, and side by side where they are evaluated so
static void evaluate_inputs(flex_stages *stages, double t, double h) {
  const flex_tableau *tableau = stages->tableau;
  int s = tableau->stages, m = stages->inputs->count;
#ifdef FLEX_IN_LANES
  if (flex_lanes_serve(stages->equations)) {
    double offsets[FLEX_MAX_STAGES], *lanes = stages->u + FLEX_MAX_STAGES * m;
    flex_store_four(offsets, flex_load_four(stages->nodes) * h);
    flex_inputs_evaluate_lanes(stages->inputs, t, offsets, lanes);
    for (int k = 0; k < m; k++)
      for (int i = 0; i < s; i++) stages->u[i * m + k] = lanes[FLEX_MAX_STAGES * k + i];
    return;
  }
#endif
  for (int i = 0; i < s; i++) flex_inputs_evaluate(stages->inputs, t, tableau->c[i] * h, stages->u + i * m);
}

// residuals of all stages at the present accelerations
static int evaluate(flex_stages *stages, double h, const real *y, const real *v) {
  real span = flex_paced(h, stages->pace);
  const flex_tableau *tableau = stages->tableau;
  int n = stages->n, s = tableau->stages, m = stages->inputs->count, refused = 0;
  const real *a = stages->acceleration;
  for (int i = 0; i < s; i++) {
    real *q = stages->position + i * n, *w = stages->rate + i * n;
    flex_combine(n, s, tableau->a_squared[i], a, q);
    flex_combine(n, s, tableau->a[i], a, w);
    move(n, span, tableau->c[i] * span, y, v, q, w);
    refused |= flex_residual(stages->equations, q, w, a + i * n, stages->u + i * m, stages->residual + i * n);
  }
  return refused;
}

// positions change by about h^2/6 times the acceleration (the mean of c^2/2), rates by h times it
static void weigh(flex_stages *stages, real h) {
  real position = h * h / 6.0;
  for (int c = 0; c < stages->n; c++)
    stages->weight[c] = h * h * stages->rate_weight[c] + position * position * stages->position_weight[c];
}

// size of stage accelerations in the error norm of the positions and rates that they make in one step, of the worst lane
static double stage_norm(const flex_stages *stages, const real *x, real scale) {
  const flex_tableau *tableau = stages->tableau;
  int n = stages->n;
  real sum = flex_real(0.0);
  for (int i = 0; i < tableau->stages; i++) {
    real part = flex_real(0.0);
    for (int c = 0; c < n; c++) part += stages->weight[c] * x[i * n + c] * x[i * n + c];
    sum += tableau->b[i] * part;
  }
  return flex_worst(flex_sqrt(sum), scale);
}

// what a correction leaves, for its own size: the contraction that was measured, grown in proportion with the matrix's age
static double expected_contraction(const flex_stages_record *record, double h) {
  if (record->contraction == 0.0) return 0.0;
  return fmin(record->contraction * (record->age + h) / record->contraction_age, MOST_EXPECTED);
}

static void note_contraction(flex_stages_record *record, double h, double contraction) {
  record->contraction = contraction;
  record->contraction_age = record->age + h;
  record->unchecked_steps = 0;
}

// one correction of all stages and its size; returns 0, or 1 if the model refused to be evaluated
static int correct(flex_stages *stages, double h, const real *y, const real *v, real scale, double *size) {
#ifdef FLEX_IN_LANES
  if (flex_lanes_serve(stages->equations)) {
    *size = correct_lanes(stages, h, y, v, scale);
    return 0;
  }
#endif
  int count = stages->tableau->stages * stages->n;
  if (evaluate(stages, h, y, v)) return 1;
  flex_newton_solve(&stages->matrix, stages->residual);
  for (int i = 0; i < count; i++) stages->acceleration[i] -= stages->residual[i];
  *size = stage_norm(stages, stages->residual, scale);
  return 0;
}

// newton iterations with the present matrix
static flex_outcome repeat_corrections(flex_stages *stages, double h, const real *y, const real *v, real scale, double target) {
  flex_stages_record *record = stages->record;
  int least = record->unchecked_steps >= UNCHECKED_STEPS ? 2 : 1;
  double floor = ROUNDING * DBL_EPSILON * (flex_common(scale) + stage_norm(stages, stages->acceleration, scale));
  double enough = fmax(target, floor / ROUNDING);
  double previous = 0.0, contraction = expected_contraction(record, h);

  for (int k = 1; k <= MAX_ITERATIONS; k++) {
    // one correction and its size
    double correction;
    if (correct(stages, h, y, v, scale, &correction)) return FLEX_NOT_FINITE;
    record->iterations++;
    if (!isfinite(correction)) return FLEX_NOT_FINITE;
    if (k == 1) record->misprediction = correction;
    if (k > 1) contraction = correction / previous;

    // rounding errors don't contract; otherwise the contraction that was seen says what is left
    int is_rounding = correction <= floor || (contraction >= 0.5 && correction <= STAGNATION * floor);
    if (k > 1)
      note_contraction(record, h, is_rounding ? fmin(fmax(correction, floor) / previous, MOST_ROUNDED) : contraction);
    if (is_rounding) return FLEX_DONE;
    if (contraction >= HOPELESS_CONTRACTION) return FLEX_NO_CONVERGENCE;
    if (k >= least && contraction / (1.0 - contraction) * correction <= enough) return FLEX_DONE;
    previous = correction;
  }
  return FLEX_NO_CONVERGENCE;
}

// the same; side by side where the residual is evaluated so
static flex_outcome iterate(flex_stages *stages, double h, const real *y, const real *v, real scale, double target) {
#ifdef FLEX_IN_LANES
  int has_lanes = flex_lanes_serve(stages->equations);
  if (has_lanes) spread_stages(stages, stages->acceleration, stages->lanes);
#endif
  flex_outcome outcome = repeat_corrections(stages, h, y, v, scale, target);
#ifdef FLEX_IN_LANES
  if (has_lanes) collect_stages(stages, stages->lanes, stages->acceleration);
#endif
  return outcome;
}

// the present matrix does not even make the iterations converge well
static int is_useless(const flex_stages_record *record) {
  return !record->matrix.is_known || record->contraction > WORN_CONTRACTION;
}

static int renews_mass_alone(const flex_stages *stages) {
  const flex_model *model = stages->equations->model;
  int may_change = model->n_first < stages->n && !model->jacobian.call;
  return may_change && !is_useless(stages->record) && stages->record->renewals < MOST_RENEWALS;
}

// a refresh pays when the iterations that it would have saved cost as much: the mass matrix, if need be 2 n residuals, and
// the factors against the residuals and the solution of the stages, which take about as long; sparse ones hardly count
static int is_worn(const flex_stages *stages) {
  const flex_stages_record *record = stages->record;
  double saved = record->excess_iterations * 2.0 * stages->tableau->stages;
  double share = stages->matrix.sparse ? 0.2 : renews_mass_alone(stages) ? 1.0 : 3.0;
  return is_useless(record) || saved > share * stages->n + 10.0;
}

// matrix at the start of the step, with the inputs at its middle
static int refresh(flex_stages *stages, double t, double h, const real *y, const real *v, const real *a,
                   real scale) {
  flex_stages_record *record = stages->record;
  int mass_alone = renews_mass_alone(stages);
  flex_inputs_evaluate(stages->inputs, t, 0.5 * h, stages->u);
  record->renewals = mass_alone ? record->renewals + 1 : 0;
  record->excess_iterations = 0.0;
  record->contraction = 0.0;
  record->age = 0.0;
  record->fresh_steps = 0;
  record->unchecked_steps = UNCHECKED_STEPS;
  if (mass_alone) return flex_newton_renew_mass(&stages->matrix, stages->equations, y, stages->u);
  return flex_newton_refresh(&stages->matrix, stages->equations, y, v, a, stages->u, stages->position_weight,
                             stages->rate_weight, scale);
}

// iterations beyond the best step since the refresh count as excess, but for the one that measures the contraction
static void note_iterations(flex_stages_record *record, double h, int taken, int measured) {
  double useful = taken - (measured && taken == 2);
  if (record->fresh_steps == 0 || useful < record->usual_iterations) record->usual_iterations = useful;
  record->excess_iterations += useful - record->usual_iterations;
  record->age += h;
  record->fresh_steps++;
  record->unchecked_steps++;
}

flex_outcome flex_stages_solve(flex_stages *stages, double t, double h, const real *y, const real *v, const real *a0,
                               real scale, double target) {
  flex_stages_record *record = stages->record;
  const flex_tableau *tableau = stages->tableau;
  weigh(stages, flex_paced(h, stages->pace));

  for (;;) {
    // matrix and inputs of this step
    if (is_worn(stages) && refresh(stages, t, h, y, v, a0, scale)) return FLEX_NOT_FINITE;
    if (flex_newton_factor(&stages->matrix, h, stages->pace)) return FLEX_NOT_FINITE;
    evaluate_inputs(stages, t, h);
    int was_fresh = record->fresh_steps == 0, measures = record->unchecked_steps >= UNCHECKED_STEPS;
    long long before = record->iterations;
    flex_outcome outcome = iterate(stages, h, y, v, scale, target);
    if (outcome == FLEX_DONE) {
      note_iterations(record, h, (int)(record->iterations - before), measures);
      return outcome;
    }

    // one more attempt with a fresh matrix and the plainest prediction, if the matrix was an old one
    flex_newton_clear(&stages->matrix);
    if (was_fresh) return outcome;
    for (int i = 0; i < tableau->stages; i++)
      memcpy(stages->acceleration + i * stages->n, a0, (size_t)stages->n * sizeof *a0);
  }
}

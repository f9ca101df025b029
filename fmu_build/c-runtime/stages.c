#include "stages.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "linear_algebra.h"

/* iterations after which a step is given up: with a contraction of 0.3 all digits are there */
#define MAX_ITERATIONS 30

/* slowest contraction that an iteration may have before a fresh matrix is taken */
#define SLOW_CONTRACTION 0.3

/* relative step of the differences for D and K: about the cube root of the rounding error, since r is nearly linear */
#define DIFFERENCE 1e-5

/* relative change of the step size that the factors bear without a slower convergence than the model's own change gives */
#define STEP_CHANGE 1e-3

/* steps after which a second iteration measures the contraction, even if one was enough */
#define UNCHECKED_STEPS 8

/* rounding errors of the residual, in units of the machine precision times the size of what is summed */
#define ROUNDING 8.0

void flex_stages_take_state(flex_stages *stages, int n, flex_arena *arena) {
  size_t square = (size_t)n * (size_t)n;
  stages->n = n;
  stages->mass = flex_take_doubles(arena, square);
  stages->damping = flex_take_doubles(arena, square);
  stages->stiffness = flex_take_doubles(arena, square);
  stages->factors = flex_take_doubles(arena, 2 * FLEX_MAX_BLOCKS * square);
  stages->pivots = flex_take_ints(arena, (size_t)(FLEX_MAX_BLOCKS * n));
}

void flex_stages_take_scratch(flex_stages *stages, int n, int n_inputs, flex_arena *arena) {
  size_t size = (size_t)(FLEX_MAX_STAGES * n);
  stages->acceleration = flex_take_doubles(arena, size);
  stages->position = flex_take_doubles(arena, size);
  stages->rate = flex_take_doubles(arena, size);
  stages->residual = flex_take_doubles(arena, size);
  stages->u = flex_take_doubles(arena, (size_t)(FLEX_MAX_STAGES * n_inputs));
  stages->weight = flex_take_doubles(arena, (size_t)n);
  stages->block = flex_take_doubles(arena, 2 * (size_t)n);
  stages->probe = flex_take_doubles(arena, 2 * (size_t)n);
}

void flex_stages_clear(flex_stages *stages) {
  flex_stages_record *record = stages->record;
  record->factored_step = 0.0;
  record->contraction = 0.0;
  record->excess_iterations = 0.0;
  record->usual_iterations = 0.0;
  record->have_jacobian = 0;
  record->fresh_steps = 0;
  record->unchecked_steps = UNCHECKED_STEPS;
}

double flex_error_norm(int n, const double *position_weight, const double *rate_weight, const double *dy, const double *dv) {
  double sum = 0.0;
  for (int i = 0; i < n; i++) sum += position_weight[i] * dy[i] * dy[i] + rate_weight[i] * dv[i] * dv[i];
  return sqrt(sum);
}

// a coordinate's share of the scale; a coordinate without weight is taken to be of order one
static double coordinate_scale(double scale, double weight) {
  return weight > 0.0 ? scale / sqrt(weight) : 1.0;
}

// one column of a difference quotient: dr/dx_i, x being y or v
static int difference_column(flex_stages *stages, const double *y, const double *v, const double *a, const double *u, double *x,
                             int i, double size, const double *r, double *column) {
  double kept = x[i];
  x[i] = kept + DIFFERENCE * fmax(size, fabs(kept));
  double step = x[i] - kept;
  int refused = flex_residual(stages->equations, y, v, a, u, column);
  x[i] = kept;
  for (int k = 0; k < stages->n; k++) column[k] = (column[k] - r[k]) / step;
  return refused;
}

// M, D and K at y, v, a with the inputs at the middle of the step
static int refresh_jacobian(flex_stages *stages, double t, double h, const double *y0, const double *v0, const double *a,
                            double scale) {
  int n = stages->n;
  double *y = stages->probe, *v = y + n, *r = stages->block, *u = stages->u;
  memcpy(y, y0, (size_t)n * sizeof *y);
  memcpy(v, v0, (size_t)n * sizeof *v);
  flex_inputs_evaluate(stages->inputs, t, 0.5 * h, u);

  int refused = flex_mass_matrix(stages->equations, y, u, stages->mass);
  refused |= flex_residual(stages->equations, y, v, a, u, r);
  for (int i = 0; i < n; i++) {
    double dy = coordinate_scale(scale, stages->position_weight[i]), dv = coordinate_scale(scale, stages->rate_weight[i]);
    refused |= difference_column(stages, y, v, a, u, y, i, dy, r, stages->stiffness + i * n);
    refused |= difference_column(stages, y, v, a, u, v, i, dv, r, stages->damping + i * n);
  }

  stages->record->have_jacobian = !refused;
  stages->record->factored_step = 0.0;
  stages->record->excess_iterations = 0.0;
  stages->record->fresh_steps = 0;
  stages->record->unchecked_steps = UNCHECKED_STEPS;
  stages->record->contraction = 0.0;
  return refused;
}

// matrix of one eigenvalue z: M + h z D + h^2 z^2 K
static void assemble_block(const flex_stages *stages, const flex_eigenvalue *z, double h, double *block) {
  const double *mass = stages->mass, *damping = stages->damping, *stiffness = stages->stiffness;
  int count = stages->n * stages->n;
  double re = h * z->value[0], im = h * z->value[1];
  double square_re = re * re - im * im, square_im = 2.0 * re * im;
  if (!z->is_complex)
    for (int i = 0; i < count; i++) block[i] = mass[i] + re * damping[i] + square_re * stiffness[i];
  else
    for (int i = 0; i < count; i++) {
      block[2 * i] = mass[i] + re * damping[i] + square_re * stiffness[i];
      block[2 * i + 1] = im * damping[i] + square_im * stiffness[i];
    }
}

static int factor_blocks(flex_stages *stages, double h) {
  const flex_tableau *tableau = stages->tableau;
  int n = stages->n, singular = 0;
  for (int k = 0; k < tableau->n_blocks; k++) {
    double *block = stages->factors + 2 * k * n * n;
    assemble_block(stages, &tableau->blocks[k], h, block);
    singular |= tableau->blocks[k].is_complex ? flex_complex_lu_factor(n, block, stages->pivots + k * n)
                                              : flex_lu_factor(n, block, stages->pivots + k * n);
  }
  stages->record->factored_step = singular ? 0.0 : h;
  stages->record->factorisations++;
  return singular;
}

// residual [stages n] replaced by the newton increment
static void solve_blocks(flex_stages *stages) {
  const flex_tableau *tableau = stages->tableau;
  int n = stages->n, s = tableau->stages;
  double *r = stages->residual, *x = stages->block;
  double increment[FLEX_MAX_STAGES];
  double *sum = stages->position;  // free between evaluations
  memset(sum, 0, (size_t)(s * n) * sizeof *sum);

  for (int k = 0; k < tableau->n_blocks; k++) {
    const flex_eigenvalue *z = &tableau->blocks[k];
    const double *factors = stages->factors + 2 * k * n * n;
    const int *pivots = stages->pivots + k * n;

    // component of the residual along the eigenvector, solution, and back to the stages
    if (z->is_complex) {
      for (int c = 0; c < n; c++) {
        double re = 0.0, im = 0.0;
        for (int i = 0; i < s; i++) re += z->left[i][0] * r[i * n + c], im += z->left[i][1] * r[i * n + c];
        x[2 * c] = re, x[2 * c + 1] = im;
      }
      flex_complex_lu_solve(n, factors, pivots, x);
      for (int i = 0; i < s; i++)
        for (int c = 0; c < n; c++) sum[i * n + c] += z->right[i][0] * x[2 * c] - z->right[i][1] * x[2 * c + 1];
    } else {
      for (int i = 0; i < s; i++) increment[i] = z->left[i][0];
      for (int c = 0; c < n; c++) {
        double re = 0.0;
        for (int i = 0; i < s; i++) re += increment[i] * r[i * n + c];
        x[c] = re;
      }
      flex_lu_solve(n, factors, pivots, x);
      for (int i = 0; i < s; i++)
        for (int c = 0; c < n; c++) sum[i * n + c] += z->right[i][0] * x[c];
    }
  }
  memcpy(r, sum, (size_t)(s * n) * sizeof *r);
}

// residuals of all stages at the present accelerations
static int evaluate_stages(flex_stages *stages, double h, const double *y, const double *v) {
  const flex_tableau *tableau = stages->tableau;
  int n = stages->n, s = tableau->stages, m = stages->inputs->count, refused = 0;
  const double *a = stages->acceleration;
  for (int i = 0; i < s; i++) {
    double *q = stages->position + i * n, *w = stages->rate + i * n;
    double drift = tableau->c[i] * h;
    for (int c = 0; c < n; c++) {
      double dq = 0.0, dw = 0.0;
      for (int j = 0; j < s; j++) {
        dq += tableau->a_squared[i][j] * a[j * n + c];
        dw += tableau->a[i][j] * a[j * n + c];
      }
      q[c] = y[c] + (drift * v[c] + h * h * dq);
      w[c] = v[c] + h * dw;
    }
    refused |= flex_residual(stages->equations, q, w, a + i * n, stages->u + i * m, stages->residual + i * n);
  }
  return refused;
}

// size of accelerations in the error norm of the positions and rates that they make in one step
static double stage_norm(const flex_stages *stages, const double *x) {
  const flex_tableau *tableau = stages->tableau;
  int n = stages->n;
  double sum = 0.0;
  for (int i = 0; i < tableau->stages; i++) {
    double part = 0.0;
    for (int c = 0; c < n; c++) part += stages->weight[c] * x[i * n + c] * x[i * n + c];
    sum += tableau->b[i] * part;
  }
  return sqrt(sum);
}

// positions change by about h^2/6 times the acceleration (the mean of c^2/2), rates by h times it
static void weigh_stages(flex_stages *stages, double h) {
  double position = h * h / 6.0;
  for (int c = 0; c < stages->n; c++)
    stages->weight[c] = h * h * stages->rate_weight[c] + position * position * stages->position_weight[c];
}

// newton iterations with the present matrix
static flex_outcome iterate(flex_stages *stages, double h, const double *y, const double *v, double scale, double target) {
  flex_stages_record *record = stages->record;
  int count = stages->tableau->stages * stages->n;
  int least = record->unchecked_steps >= UNCHECKED_STEPS ? 2 : 1;
  double floor = ROUNDING * DBL_EPSILON * (scale + stage_norm(stages, stages->acceleration));
  double previous = 0.0, contraction = record->contraction;

  for (int k = 1; k <= MAX_ITERATIONS; k++) {
    if (evaluate_stages(stages, h, y, v)) return FLEX_NOT_FINITE;
    solve_blocks(stages);
    for (int i = 0; i < count; i++) stages->acceleration[i] -= stages->residual[i];
    record->iterations++;

    double increment = stage_norm(stages, stages->residual);
    if (!isfinite(increment)) return FLEX_NOT_FINITE;
    if (k == 1) record->misprediction = increment;
    if (k > 1) {
      contraction = increment / previous;
      record->unchecked_steps = 0;
    }

    // rounding errors don't contract; otherwise the contraction that was seen says what is left
    if (increment <= floor || (contraction >= 0.5 && increment <= 1e3 * floor)) return FLEX_DONE;
    if (contraction >= 0.9) return FLEX_NO_CONVERGENCE;
    record->contraction = contraction;
    if (k >= least && contraction / (1.0 - contraction) * increment <= target) return FLEX_DONE;
    previous = increment;
  }
  return FLEX_NO_CONVERGENCE;
}

// a refresh pays when the iterations that it would have saved cost as much: 2 n residuals against s per iteration
static int matrix_is_worn(const flex_stages *stages) {
  const flex_stages_record *record = stages->record;
  double cost = record->excess_iterations * 2.0 * stages->tableau->stages;
  return !record->have_jacobian || record->contraction > SLOW_CONTRACTION || cost > 3.0 * stages->n + 10.0;
}

// iterations beyond the best step since the refresh count as excess, but for the one that measures the contraction
static void note_iterations(flex_stages_record *record, int taken, int measured) {
  double useful = taken - (measured && taken == 2);
  if (record->fresh_steps == 0 || useful < record->usual_iterations) record->usual_iterations = useful;
  record->excess_iterations += useful - record->usual_iterations;
  record->fresh_steps++;
  record->unchecked_steps++;
}

flex_outcome flex_stages_solve(flex_stages *stages, double t, double h, const double *y, const double *v, const double *a0,
                               double scale, double target) {
  flex_stages_record *record = stages->record;
  const flex_tableau *tableau = stages->tableau;
  weigh_stages(stages, h);

  for (int attempt = 0;; attempt++) {
    // matrix and inputs of this step
    if (attempt > 0 || matrix_is_worn(stages))
      if (refresh_jacobian(stages, t, h, y, v, a0, scale)) return FLEX_NOT_FINITE;
    if (fabs(h - record->factored_step) > STEP_CHANGE * h)
      if (factor_blocks(stages, h)) return FLEX_NOT_FINITE;
    for (int i = 0; i < tableau->stages; i++)
      flex_inputs_evaluate(stages->inputs, t, tableau->c[i] * h, stages->u + i * stages->inputs->count);

    // one more attempt with a fresh matrix if an old one failed
    int was_fresh = record->fresh_steps == 0, measures = record->unchecked_steps >= UNCHECKED_STEPS;
    long long before = record->iterations;
    flex_outcome outcome = iterate(stages, h, y, v, scale, target);
    if (outcome == FLEX_DONE) {
      note_iterations(record, (int)(record->iterations - before), measures);
      return outcome;
    }
    record->have_jacobian = 0;
    if (was_fresh) return outcome;
    for (int i = 0; i < tableau->stages; i++) memcpy(stages->acceleration + i * stages->n, a0, (size_t)stages->n * sizeof *a0);
  }
}

void flex_stages_filter(flex_stages *stages, double *x) {
  int n = stages->n;
  const flex_eigenvalue *z = &stages->tableau->blocks[0];
  double *rhs = stages->block;

  // M x, stored as the block wants it
  int width = z->is_complex ? 2 : 1;
  for (int i = 0; i < width * n; i++) rhs[i] = 0.0;
  for (int j = 0; j < n; j++)
    for (int i = 0; i < n; i++) rhs[width * i] += stages->mass[j * n + i] * x[j];

  if (z->is_complex) {
    flex_complex_lu_solve(n, stages->factors, stages->pivots, rhs);
    for (int i = 0; i < n; i++) x[i] = hypot(rhs[2 * i], rhs[2 * i + 1]);
  } else {
    flex_lu_solve(n, stages->factors, stages->pivots, rhs);
    memcpy(x, rhs, (size_t)n * sizeof *x);
  }
}

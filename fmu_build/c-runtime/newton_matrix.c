#include "newton_matrix.h"

#include <math.h>
#include <string.h>

#include "linear_algebra.h"

/* relative step of the differences for D and K: about the cube root of the rounding error, since r is nearly linear */
#define DIFFERENCE 1e-5

/* relative change of the step size that the factors bear: the convergence suffers less than from the model's own change */
#define STEP_CHANGE 1e-3

void flex_newton_take_state(flex_newton_matrix *matrix, int n, flex_arena *arena) {
  size_t square = (size_t)n * (size_t)n;
  matrix->n = n;
  matrix->mass = flex_take_doubles(arena, square);
  matrix->damping = flex_take_doubles(arena, square);
  matrix->stiffness = flex_take_doubles(arena, square);
  matrix->factors = flex_take_doubles(arena, 2 * FLEX_MAX_BLOCKS * square);
  matrix->pivots = flex_take_ints(arena, (size_t)(FLEX_MAX_BLOCKS * n));
}

void flex_newton_take_scratch(flex_newton_matrix *matrix, int n, flex_arena *arena) {
  size_t size = (size_t)n;
  matrix->component = flex_take_doubles(arena, 2 * size);
  matrix->sum = flex_take_doubles(arena, FLEX_MAX_STAGES * size);
  matrix->y = flex_take_doubles(arena, size);
  matrix->v = flex_take_doubles(arena, size);
  matrix->r = flex_take_doubles(arena, size);
}

void flex_newton_clear(flex_newton_matrix *matrix) {
  matrix->record->factored_step = 0.0;
  matrix->record->is_known = 0;
}

// a coordinate's share of the scale; a coordinate without weight is taken to be of order one
static double coordinate_scale(double scale, double weight) {
  return weight > 0.0 ? scale / sqrt(weight) : 1.0;
}

// one column of dr/dx: x is the y or the v of the matrix, r the residual there
static int difference_column(flex_newton_matrix *matrix, flex_equations *equations, const double *a, const double *u,
                             double *x, int i, double size, double *column) {
  double kept = x[i];
  x[i] = kept + DIFFERENCE * fmax(size, fabs(kept));
  double step = x[i] - kept;
  int refused = flex_residual(equations, matrix->y, matrix->v, a, u, column);
  x[i] = kept;
  for (int k = 0; k < matrix->n; k++) column[k] = (column[k] - matrix->r[k]) / step;
  return refused;
}

int flex_newton_refresh(flex_newton_matrix *matrix, flex_equations *equations, const double *y, const double *v,
                        const double *a, const double *u, const double *position_weight, const double *rate_weight,
                        double scale) {
  int n = matrix->n;
  memcpy(matrix->y, y, (size_t)n * sizeof *y);
  memcpy(matrix->v, v, (size_t)n * sizeof *v);
  int refused = flex_mass_matrix(equations, y, u, matrix->mass);
  refused |= flex_residual(equations, y, v, a, u, matrix->r);
  for (int i = 0; i < n; i++) {
    double dy = coordinate_scale(scale, position_weight[i]), dv = coordinate_scale(scale, rate_weight[i]);
    refused |= difference_column(matrix, equations, a, u, matrix->y, i, dy, matrix->stiffness + i * n);
    refused |= difference_column(matrix, equations, a, u, matrix->v, i, dv, matrix->damping + i * n);
  }
  matrix->record->is_known = !refused;
  matrix->record->factored_step = 0.0;
  return refused;
}

int flex_newton_renew_mass(flex_newton_matrix *matrix, flex_equations *equations, const double *y, const double *u) {
  matrix->record->factored_step = 0.0;
  return flex_mass_matrix(equations, y, u, matrix->mass);
}

// matrix of one eigenvalue z: M + h z D + h^2 z^2 K
static void assemble(const flex_newton_matrix *matrix, const flex_eigenvalue *z, double h, double *block) {
  const double *mass = matrix->mass, *damping = matrix->damping, *stiffness = matrix->stiffness;
  int count = matrix->n * matrix->n;
  double re = h * z->value[0], im = h * z->value[1];
  double square_re = re * re - im * im, square_im = 2.0 * re * im;
  if (!z->is_complex) {
    for (int i = 0; i < count; i++) block[i] = mass[i] + re * damping[i] + square_re * stiffness[i];
    return;
  }
  for (int i = 0; i < count; i++) {
    block[2 * i] = mass[i] + re * damping[i] + square_re * stiffness[i];
    block[2 * i + 1] = im * damping[i] + square_im * stiffness[i];
  }
}

// place of the factors and the pivots of one eigenvalue
static double *factors_of(const flex_newton_matrix *matrix, int block) {
  return matrix->factors + 2 * block * matrix->n * matrix->n;
}

static int *pivots_of(const flex_newton_matrix *matrix, int block) {
  return matrix->pivots + block * matrix->n;
}

int flex_newton_factor(flex_newton_matrix *matrix, double h) {
  const flex_tableau *tableau = matrix->tableau;
  int singular = 0;
  if (fabs(h - matrix->record->factored_step) <= STEP_CHANGE * h) return 0;
  for (int k = 0; k < tableau->n_blocks; k++) {
    double *factors = factors_of(matrix, k);
    assemble(matrix, &tableau->blocks[k], h, factors);
    singular |= tableau->blocks[k].is_complex ? flex_complex_lu_factor(matrix->n, factors, pivots_of(matrix, k))
                                              : flex_lu_factor(matrix->n, factors, pivots_of(matrix, k));
  }
  matrix->record->factored_step = singular ? 0.0 : h;
  matrix->record->factorisations++;
  return singular;
}

// the part of the solution that belongs to a real eigenvalue, added to the sum
static void solve_real(flex_newton_matrix *matrix, int block, const double *x) {
  const flex_eigenvalue *z = &matrix->tableau->blocks[block];
  int n = matrix->n, s = matrix->tableau->stages;
  double *component = matrix->component, *sum = matrix->sum;

  // component along the eigenvector, solution, back to the stages
  for (int c = 0; c < n; c++) {
    double value = 0.0;
    for (int i = 0; i < s; i++) value += z->left[i][0] * x[i * n + c];
    component[c] = value;
  }
  flex_lu_solve(n, factors_of(matrix, block), pivots_of(matrix, block), component);
  for (int i = 0; i < s; i++)
    for (int c = 0; c < n; c++) sum[i * n + c] += z->right[i][0] * component[c];
}

// the same for a pair of complex ones
static void solve_complex(flex_newton_matrix *matrix, int block, const double *x) {
  const flex_eigenvalue *z = &matrix->tableau->blocks[block];
  int n = matrix->n, s = matrix->tableau->stages;
  double *component = matrix->component, *sum = matrix->sum;
  for (int c = 0; c < n; c++) {
    double re = 0.0, im = 0.0;
    for (int i = 0; i < s; i++) {
      re += z->left[i][0] * x[i * n + c];
      im += z->left[i][1] * x[i * n + c];
    }
    component[2 * c] = re;
    component[2 * c + 1] = im;
  }
  flex_complex_lu_solve(n, factors_of(matrix, block), pivots_of(matrix, block), component);
  for (int i = 0; i < s; i++)
    for (int c = 0; c < n; c++) sum[i * n + c] += z->right[i][0] * component[2 * c] - z->right[i][1] * component[2 * c + 1];
}

void flex_newton_solve(flex_newton_matrix *matrix, double *x) {
  size_t size = (size_t)(matrix->tableau->stages * matrix->n) * sizeof *x;
  memset(matrix->sum, 0, size);
  for (int k = 0; k < matrix->tableau->n_blocks; k++) {
    if (matrix->tableau->blocks[k].is_complex)
      solve_complex(matrix, k, x);
    else
      solve_real(matrix, k, x);
  }
  memcpy(x, matrix->sum, size);
}

void flex_newton_filter(flex_newton_matrix *matrix, double *x) {
  int n = matrix->n, is_complex = matrix->tableau->blocks[0].is_complex, width = is_complex ? 2 : 1;
  double *rhs = matrix->component;

  // M x, stored as the first eigenvalue wants it
  memset(rhs, 0, (size_t)(width * n) * sizeof *rhs);
  for (int j = 0; j < n; j++)
    for (int i = 0; i < n; i++) rhs[width * i] += matrix->mass[j * n + i] * x[j];

  if (!is_complex) {
    flex_lu_solve(n, matrix->factors, matrix->pivots, rhs);
    memcpy(x, rhs, (size_t)n * sizeof *x);
    return;
  }
  flex_complex_lu_solve(n, matrix->factors, matrix->pivots, rhs);
  for (int i = 0; i < n; i++) x[i] = hypot(rhs[2 * i], rhs[2 * i + 1]);
}

/* The Newton matrix of s stages, split by the eigenvectors of the method's matrix A into s systems of size n, complex ones in
 * pairs (Butcher, On the implementation of implicit Runge-Kutta methods, BIT 16 (1976); Hairer and Wanner, Solving Ordinary
 * Differential Equations II, section IV.8). Damping and stiffness are taken by differences of the residual;
 * coordinates of first order, on which nothing depends, and the time, which moves as it is, have none. */
#include "newton_matrix.h"

#include <math.h>
#include <string.h>

#include "elementary.h"
#include "lanes_stages.h"
#include "linear_algebra.h"

/* relative step of the differences for D and K: about the cube root of the rounding error, since r is nearly linear */
#define DIFFERENCE 1e-5

/* relative change of the step size that the inverses bear: the convergence suffers less than from the model's own change */
#define STEP_CHANGE 1e-3

enum { LANES = 4 };

void flex_newton_take_state(flex_newton_matrix *matrix, const flex_model *model, flex_arena *arena) {
  matrix->n = model->n;
  matrix->sparse = model->sparse;
  matrix->entries = model->sparse ? model->sparse->count : model->n * model->n;
  size_t size = (size_t)matrix->entries;
  real *all = flex_take_reals(arena, 3 * size);
  if (all) matrix->mass = all, matrix->damping = all + size, matrix->stiffness = all + 2 * size;
  matrix->inverses = flex_take_reals(arena, 2 * 2 * FLEX_MAX_BLOCKS * size);
}

void flex_newton_take_scratch(flex_newton_matrix *matrix, int n, int n_inputs, flex_arena *arena) {
  size_t size = (size_t)n;
  matrix->component = flex_take_reals(arena, FLEX_MAX_STAGES * size);
  matrix->solution = flex_take_reals(arena, FLEX_MAX_STAGES * size);
  matrix->pivots = flex_take_ints(arena, size);
  matrix->y = flex_take_reals(arena, size);
  matrix->v = flex_take_reals(arena, size);
  matrix->r = flex_take_reals(arena, size);
  matrix->lanes = flex_take_reals(arena, LANES * (4 * size + (size_t)n_inputs));
}

// M, D or K is another one
static void forget_inverses(flex_newton_matrix *matrix) {
  matrix->record->steps[0] = matrix->record->steps[1] = 0.0;
}

void flex_newton_clear(flex_newton_matrix *matrix) {
  forget_inverses(matrix);
  matrix->record->is_known = 0;
}

// a coordinate's share of the scale; a coordinate without weight is taken to be of order one
static real coordinate_scale(real scale, real weight) {
  return flex_if_positive(weight, scale / flex_sqrt(weight), flex_real(1.0));
}

// one column of dr/dx: x is the y or the v of the matrix, r the residual there
static int difference_column(flex_newton_matrix *matrix, flex_equations *equations, const real *a, const real *u,
                             real *x, int i, real size, real *column) {
  real kept = x[i];
  x[i] = kept + DIFFERENCE * flex_larger(size, flex_fabs(kept));
  real step = x[i] - kept;
  int refused = flex_residual(equations, matrix->y, matrix->v, a, u, column);
  x[i] = kept;
  for (int k = 0; k < matrix->n; k++) column[k] = (column[k] - matrix->r[k]) / step;
  return refused;
}

#ifdef FLEX_IN_LANES
static void spread(int n, const real *x, real *lanes) {
  for (int c = 0; c < n; c++)
    for (int lane = 0; lane < LANES; lane++) lanes[LANES * c + lane] = x[c];
}

// all columns of dr/dy and dr/dv, those of two coordinates side by side
static void difference_lanes(flex_newton_matrix *matrix, flex_equations *equations, const real *a, const real *u,
                             const real *position_weight, const real *rate_weight, double scale) {
  int n = matrix->n;
  real *y = matrix->lanes, *v = y + LANES * n, *at = v + LANES * n, *r = at + LANES * n, *inputs = r + LANES * n;
  spread(n, matrix->y, y);
  spread(n, matrix->v, v);
  spread(n, a, at);
  spread(equations->model->n_inputs, u, inputs);

  for (int first = 0; first < n; first += 2) {
    // lanes: a change of y and one of v, then those of the next coordinate
    double step[LANES];
    for (int lane = 0; lane < LANES; lane++) {
      int i = first + lane / 2;
      if (i == n) continue;
      real *x = (lane % 2 ? v : y) + LANES * i + lane, kept = *x;
      double size = coordinate_scale(scale, (lane % 2 ? rate_weight : position_weight)[i]);
      int moves = i < (lane % 2 ? flex_state_rates(equations->model) : flex_state_coordinates(equations->model));
      if (moves) *x = kept + DIFFERENCE * fmax(size, fabs(kept));
      step[lane] = moves ? *x - kept : HUGE_VAL;
    }
    flex_residual_lanes(equations, first + 1 < n ? LANES : 2, y, v, at, inputs, r);
    for (int lane = 0; lane < LANES; lane++) {
      int i = first + lane / 2;
      if (i == n) continue;
      real *column = (lane % 2 ? matrix->damping : matrix->stiffness) + i * n;
      for (int k = 0; k < n; k++) column[k] = (r[LANES * k + lane] - matrix->r[k]) / step[lane];
      (lane % 2 ? v : y)[LANES * i + lane] = (lane % 2 ? matrix->v : matrix->y)[i];
    }
  }
}
#endif

int flex_newton_refresh(flex_newton_matrix *matrix, flex_equations *equations, const real *y, const real *v,
                        const real *a, const real *u, const real *position_weight, const real *rate_weight,
                        real scale) {
  int n = matrix->n;
  if (equations->model->jacobian.call) {
    const real *const arguments[] = {y, v, a, u, equations->d};
    matrix->record->is_known = !flex_call(equations, &equations->model->jacobian, 5, arguments, matrix->mass);
    forget_inverses(matrix);
    return !matrix->record->is_known;
  }
  memcpy(matrix->y, y, (size_t)n * sizeof *y);
  memcpy(matrix->v, v, (size_t)n * sizeof *v);
  int refused = flex_mass_matrix(equations, y, u, matrix->mass);
  refused |= flex_residual(equations, y, v, a, u, matrix->r);
  int has_lanes = 0;
#ifdef FLEX_IN_LANES
  has_lanes = flex_lanes_serve(equations);
  if (has_lanes) difference_lanes(matrix, equations, a, u, position_weight, rate_weight, scale);
#endif
  for (int i = 0; i < n && !has_lanes; i++) {
    // what is held doesn't move: with anything in its columns, rounding errors of the inverse would move it
    int is_held = flex_is_held(equations, i);
    real dy = coordinate_scale(scale, position_weight[i]), dv = coordinate_scale(scale, rate_weight[i]);
    memset(matrix->stiffness + i * n, 0, (size_t)n * sizeof *y);
    memset(matrix->damping + i * n, 0, (size_t)n * sizeof *y);
    if (!is_held && i < flex_state_coordinates(equations->model))
      refused |= difference_column(matrix, equations, a, u, matrix->y, i, dy, matrix->stiffness + i * n);
    if (!is_held && i < flex_state_rates(equations->model))
      refused |= difference_column(matrix, equations, a, u, matrix->v, i, dv, matrix->damping + i * n);
  }
  matrix->record->is_known = !refused;
  forget_inverses(matrix);
  return refused;
}

int flex_newton_renew_mass(flex_newton_matrix *matrix, flex_equations *equations, const real *y, const real *u) {
  forget_inverses(matrix);
  return flex_mass_matrix(equations, y, u, matrix->mass);
}

// matrix of one eigenvalue z: M + h z D + h^2 z^2 K
static void assemble(const flex_newton_matrix *matrix, const flex_eigenvalue *z, real h, real *block) {
  const real *mass = matrix->mass, *damping = matrix->damping, *stiffness = matrix->stiffness;
  int count = matrix->entries;
  real re = h * z->value[0], im = h * z->value[1];
  real square_re = re * re - im * im, square_im = 2.0 * re * im;
  if (!z->is_complex) {
    for (int i = 0; i < count; i++) block[i] = mass[i] + re * damping[i] + square_re * stiffness[i];
    return;
  }
  for (int i = 0; i < count; i++) {
    block[2 * i] = mass[i] + re * damping[i] + square_re * stiffness[i];
    block[2 * i + 1] = im * damping[i] + square_im * stiffness[i];
  }
}

// place of the present inverse for one eigenvalue
static real *inverse_of(const flex_newton_matrix *matrix, int block) {
  return matrix->inverses + 2 * (FLEX_MAX_BLOCKS * matrix->record->present + block) * matrix->entries;
}

// whether the present inverses are for the step size h
static int serves(const flex_newton_record *record, double h) {
  return fabs(h - record->steps[record->present]) <= STEP_CHANGE * h;
}

int flex_newton_factor(flex_newton_matrix *matrix, double h, real pace) {
  flex_newton_record *record = matrix->record;
  const flex_tableau *tableau = matrix->tableau;
  int singular = 0;

  // present ones, those before: a step and its halves take turns
  if (serves(record, h)) return 0;
  record->present = 1 - record->present;
  if (serves(record, h)) return 0;
  for (int k = 0; k < tableau->n_blocks; k++) {
    real *inverse = inverse_of(matrix, k);
    int is_complex = tableau->blocks[k].is_complex;
    assemble(matrix, &tableau->blocks[k], flex_paced(h, pace), inverse);
    singular |= matrix->sparse ? matrix->sparse->factor(is_complex, inverse, matrix->component)
                : is_complex   ? flex_complex_invert(matrix->n, inverse, matrix->pivots)
                               : flex_invert(matrix->n, inverse, matrix->pivots);
  }
  record->steps[record->present] = singular ? 0.0 : h;
  record->factorisations++;
  return singular;
}

/* the eigenvectors of A as real matrices: a row of `to` for a real eigenvalue, two for a pair of complex ones */
typedef struct {
  double to[FLEX_MAX_STAGES][FLEX_MAX_STAGES], back[FLEX_MAX_STAGES][FLEX_MAX_STAGES];
} basis;

static void real_basis(const flex_tableau *tableau, basis *found) {
  int row = 0;
  for (int k = 0; k < tableau->n_blocks; k++) {
    const flex_eigenvalue *z = &tableau->blocks[k];
    for (int i = 0; i < tableau->stages; i++) {
      found->to[row][i] = z->left[i][0];
      found->back[i][row] = z->right[i][0];
      if (!z->is_complex) continue;
      found->to[row + 1][i] = z->left[i][1];
      found->back[i][row + 1] = -z->right[i][1];
    }
    row += 1 + z->is_complex;
  }
}

// x = the inverse for one eigenvalue times b, by its sparse factors; they are not the same
static void solve_sparse(const flex_newton_matrix *matrix, int block, const real *b, real *x) {
  int is_complex = matrix->tableau->blocks[block].is_complex;
  memcpy(x, b, (size_t)((1 + is_complex) * matrix->n) * sizeof *x);
  matrix->sparse->solve(is_complex, inverse_of(matrix, block), x);
}

// the systems of all eigenvalues, components to solutions: a real eigenvalue's first, complex ones as pairs
static void solve_blocks(flex_newton_matrix *matrix) {
  const flex_tableau *tableau = matrix->tableau;
  const real *x = matrix->component;
  real *solution = matrix->solution;
  int n = matrix->n;
  for (int k = 0; k < tableau->n_blocks; k++) {
    int width = 1 + tableau->blocks[k].is_complex;
    if (matrix->sparse)
      solve_sparse(matrix, k, x, solution);
    else if (width == 1)
      flex_multiply(n, inverse_of(matrix, k), x, solution);
    else
      flex_complex_multiply(n, inverse_of(matrix, k), x, solution);
    x += width * n, solution += width * n;
  }
}

// real parts, then imaginary parts <-> pairs, for all complex eigenvalues
static void to_pairs(int n, const real *x, real *pairs) {
  for (int c = 0; c < n; c++) {
    pairs[2 * c] = x[c];
    pairs[2 * c + 1] = x[n + c];
  }
}

static void from_pairs(int n, const real *pairs, real *x) {
  for (int c = 0; c < n; c++) {
    x[c] = pairs[2 * c];
    x[n + c] = pairs[2 * c + 1];
  }
}

void flex_newton_solve(flex_newton_matrix *matrix, real *x) {
  const flex_tableau *tableau = matrix->tableau;
  int n = matrix->n, s = tableau->stages, first = !tableau->blocks[0].is_complex;
  real *split = matrix->solution, *component = matrix->component;
  basis eigenvectors;
  real_basis(tableau, &eigenvectors);

  // components along the eigenvectors, their solutions, back to the stages
  for (int i = 0; i < s; i++) flex_combine(n, s, eigenvectors.to[i], x, split + i * n);
  if (first) memcpy(component, split, (size_t)n * sizeof *x);
  for (int i = first; i < s; i += 2) to_pairs(n, split + i * n, component + i * n);
  solve_blocks(matrix);
  if (first) memcpy(component, matrix->solution, (size_t)n * sizeof *x);
  for (int i = first; i < s; i += 2) from_pairs(n, matrix->solution + i * n, component + i * n);
  for (int i = 0; i < s; i++) flex_combine(n, s, eigenvectors.back[i], component, x + i * n);
}

void flex_newton_use(flex_newton_matrix *matrix, const flex_tableau *tableau) {
  int s = tableau->stages, first = !tableau->blocks[0].is_complex;
  basis eigenvectors;
  real_basis(tableau, &eigenvectors);
  matrix->tableau = tableau;

  // a pair of components takes the first two lanes, a lone one or another pair follow; a lane without a stage repeats the last
  for (int j = 0; j < s; j++)
    for (int lane = 0; lane < FLEX_MAX_STAGES; lane++) {
      matrix->to_components[j][lane] = eigenvectors.to[(lane + first) % s][j];
      matrix->to_stages[j][lane] = eigenvectors.back[lane < s ? lane : s - 1][j];
    }
}

#ifdef FLEX_IN_LANES
void flex_newton_solve_lanes(flex_newton_matrix *matrix, double *x) {
  const flex_tableau *tableau = matrix->tableau;
  int n = matrix->n, s = tableau->stages, has_real = !tableau->blocks[0].is_complex;
  double *alone = matrix->component, *first = alone + has_real * n, *second = first + 2 * n;

  // components along the eigenvectors: a pair, and a lone one or another pair
  for (int c = 0; c < n; c++) {
    flex_four mixed = flex_mix_lanes(s, matrix->to_components, x + FLEX_MAX_STAGES * c);
    first[2 * c] = mixed[0];
    first[2 * c + 1] = mixed[1];
    if (has_real) alone[c] = mixed[2];
    if (s == 4) second[2 * c] = mixed[2], second[2 * c + 1] = mixed[3];
  }

  solve_blocks(matrix);
  alone = matrix->solution, first = alone + has_real * n, second = first + 2 * n;

  // back to the stages
  for (int c = 0; c < n; c++) {
    const double pairs[4] = {first[2 * c], first[2 * c + 1], second[2 * c], second[2 * c + 1]};
    const double both[4] = {alone[c], first[2 * c], first[2 * c + 1], 0.0};
    flex_store_four(x + FLEX_MAX_STAGES * c, flex_mix_lanes(s, matrix->to_stages, has_real ? both : pairs));
  }
}
#endif

static void filter_sparse(flex_newton_matrix *matrix, real *x) {
  int n = matrix->n;
  real *rhs = matrix->component, *solution = matrix->solution;
  matrix->sparse->multiply(matrix->mass, x, rhs);
  if (!matrix->tableau->blocks[0].is_complex) {
    solve_sparse(matrix, 0, rhs, x);
    return;
  }
  memset(rhs + n, 0, (size_t)n * sizeof *rhs);
  to_pairs(n, rhs, solution);
  solve_sparse(matrix, 0, solution, rhs);
  for (int i = 0; i < n; i++) x[i] = flex_hypot(rhs[2 * i], rhs[2 * i + 1]);
}

void flex_newton_filter(flex_newton_matrix *matrix, real *x) {
  int n = matrix->n;
  real *rhs = matrix->component, *solution = matrix->solution;
  if (matrix->sparse) {
    filter_sparse(matrix, x);
    return;
  }
  flex_multiply(n, matrix->mass, x, rhs);
  if (!matrix->tableau->blocks[0].is_complex) {
    flex_multiply(n, inverse_of(matrix, 0), rhs, x);
    return;
  }
  memset(rhs + n, 0, (size_t)n * sizeof *rhs);
  to_pairs(n, rhs, solution);
  flex_complex_multiply(n, inverse_of(matrix, 0), solution, rhs);
  for (int i = 0; i < n; i++) x[i] = flex_hypot(rhs[2 * i], rhs[2 * i + 1]);
}

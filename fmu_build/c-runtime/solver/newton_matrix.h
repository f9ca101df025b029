/* The matrix of the simplified Newton iterations for the stages of a collocation step.
 *
 * With M, D, K = dr/da, dr/dv, dr/dy at one point it is identity x M + h A x D + h^2 A A x K. In the eigenvectors of A it
 * falls apart into one matrix M + h z D + h^2 z^2 K for every eigenvalue z, of which complex ones come in pairs. */
#ifndef FLEXFMU_NEWTON_MATRIX_H
#define FLEXFMU_NEWTON_MATRIX_H

#include "equations.h"
#include "real.h"
#include "tableaus.h"

/* plain numbers, saved and restored with the state of the plant */
typedef struct {
  double steps[2];      /* step sizes of the inverted matrices [s], the present one and the one before; 0 = none */
  int present;          /* which of the two is the present one */
  int is_known;         /* 1 = M, D, K are there */
  long long factorisations;
} flex_newton_record;

typedef struct {
  int n, entries; /* of a matrix */
  const flex_sparse *sparse; /* NULL where it is dense */
  const flex_tableau *tableau;
  flex_newton_record *record;

  /* numeric state: M, D, K and the inverses of the matrices of all eigenvalues, or their factors, for two step sizes */
  real *mass, *damping, *stiffness, *inverses;

  /* scratch */
  real *component, *solution, *y, *v, *r, *lanes;
  int *pivots;

  /* eigenvectors by columns, with one lane for each component and for each stage */
  double to_components[FLEX_MAX_STAGES][FLEX_MAX_STAGES], to_stages[FLEX_MAX_STAGES][FLEX_MAX_STAGES];
} flex_newton_matrix;

void flex_newton_take_state(flex_newton_matrix *matrix, const flex_model *model, flex_arena *arena);
void flex_newton_take_scratch(flex_newton_matrix *matrix, int n, int n_inputs, flex_arena *arena);

/* chooses the method */
void flex_newton_use(flex_newton_matrix *matrix, const flex_tableau *tableau);

/* forgets M, D, K and the inverses */
void flex_newton_clear(flex_newton_matrix *matrix);

/* M, D, K at a point, by differences unless they are sparse. position_weight, rate_weight, scale: the error norm and the size of the motion in it,
 * which give each coordinate its own difference. Returns 0, or 1 if the model refused to be evaluated. */
int flex_newton_refresh(flex_newton_matrix *matrix, flex_equations *equations, const real *y, const real *v,
                        const real *a, const real *u, const real *position_weight, const real *rate_weight,
                        real scale);

/* M alone, D and K as they are. Returns 0, or 1 if the model refused to be evaluated. */
int flex_newton_renew_mass(flex_newton_matrix *matrix, flex_equations *equations, const real *y, const real *u);

/* inverses for the step size h in the lanes' own time, unless those that are there do. Returns 0, or 1 if a matrix is singular. */
int flex_newton_factor(flex_newton_matrix *matrix, double h, real pace);

/* x [stages n] replaced by the solution */
void flex_newton_solve(flex_newton_matrix *matrix, real *x);

#ifdef FLEX_IN_LANES
/* the same with the stages side by side, x [n FLEX_MAX_STAGES] */
void flex_newton_solve_lanes(flex_newton_matrix *matrix, double *x);
#endif

/* x [n] replaced by the size of inverse(M + h z D + h^2 z^2 K) M x, which leaves slow modes and takes stiff ones away */
void flex_newton_filter(flex_newton_matrix *matrix, real *x);

#endif

/* The stage equations of a collocation step and their solution by simplified Newton iterations.
 *
 * Unknowns are the stage accelerations a_i at t + c_i h; positions and rates of the stages follow from them:
 *
 *     Q_i = y + c_i h v + h^2 sum_j (A A)_ij a_j,     V_i = v + h sum_j A_ij a_j,     r(Q_i, V_i, a_i, u_i) = 0.
 *
 * The iteration matrix, identity x M + h A x D + h^2 A A x K with M, D, K = dr/da, dr/dv, dr/dy at one point, splits
 * into one matrix M + h z D + h^2 z^2 K for every eigenvalue z of A. It is kept while it makes the iterations converge. */
#ifndef FLEXFMU_STAGES_H
#define FLEXFMU_STAGES_H

#include "equations.h"
#include "inputs.h"
#include "memory.h"
#include "outcome.h"
#include "tableaus.h"

/* plain numbers, saved and restored with the state of the plant */
typedef struct {
  double factored_step;     /* step size of the factorised matrices [s]; 0 = none */
  double contraction;       /* of the last step that took more than one iteration */
  double misprediction;     /* size of the first correction of the last step, in the error norm */
  double excess_iterations; /* beyond what a fresh matrix needs, since the last refresh */
  double usual_iterations;  /* what a fresh matrix needs */
  int have_jacobian;        /* 1 = M, D, K are there */
  int fresh_steps;          /* steps since the last refresh */
  int unchecked_steps;      /* steps since the contraction was measured */
  long long iterations, factorisations, evaluations;
} flex_stages_record;

typedef struct {
  int n;
  const flex_tableau *tableau;
  flex_equations *equations;
  const flex_inputs *inputs;
  flex_stages_record *record;

  /* error norm: sqrt(sum of position_weight dy^2 + rate_weight dv^2) */
  const double *position_weight, *rate_weight;

  /* numeric state: M, D, K [n n] and the factors of all blocks */
  double *mass, *damping, *stiffness, *factors;
  int *pivots;

  /* result of the last solution, stages x n; u: stages x inputs */
  double *acceleration;

  /* scratch */
  double *position, *rate, *residual, *u, *weight, *block, *probe;
} flex_stages;

void flex_stages_take_state(flex_stages *stages, int n, flex_arena *arena);
void flex_stages_take_scratch(flex_stages *stages, int n, int n_inputs, flex_arena *arena);

/* forgets the iteration matrix */
void flex_stages_clear(flex_stages *stages);

/* solves for the step from t to t + h, starting from the prediction in `acceleration`.
 * a0 is the acceleration at t, scale the size of the motion in the error norm; the error that is left in the end
 * positions and rates is at most `target` in the same norm. */
flex_outcome flex_stages_solve(flex_stages *stages, double t, double h, const double *y, const double *v, const double *a0,
                               double scale, double target);

/* x [n] replaced by the size of inverse(M + h z D + h^2 z^2 K) M x, which leaves slow modes and takes stiff ones away */
void flex_stages_filter(flex_stages *stages, double *x);

/* sqrt(sum of position_weight dy^2 + rate_weight dv^2) */
double flex_error_norm(int n, const double *position_weight, const double *rate_weight, const double *dy, const double *dv);

#endif

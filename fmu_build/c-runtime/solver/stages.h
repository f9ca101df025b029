/* The stage equations of a collocation step and their solution by simplified Newton iterations.
 *
 * Unknowns are the stage accelerations a_i at t + c_i h; positions and rates of the stages follow from them:
 *
 *     Q_i = y + c_i h v + h^2 sum_j (A A)_ij a_j,     V_i = v + h sum_j A_ij a_j,     r(Q_i, V_i, a_i, u_i) = 0.
 *
 * The matrix of the iterations is kept while it makes them converge. */
#ifndef FLEXFMU_STAGES_H
#define FLEXFMU_STAGES_H

#include "equations.h"
#include "inputs.h"
#include "newton_matrix.h"
#include "outcome.h"
#include "real.h"
#include "tableaus.h"

/* plain numbers, saved and restored with the state of the plant */
typedef struct {
  flex_newton_record matrix;
  double contraction;       /* of the last step that took more than one iteration */
  double contraction_age;   /* age of the matrix at that step [s] */
  double age;               /* time integrated since the last refresh [s] */
  double misprediction;     /* size of the first correction of the last step, in the error norm */
  double excess_iterations; /* beyond what a fresh matrix needs, since the last refresh */
  double usual_iterations;  /* what a fresh matrix needs */
  int fresh_steps;          /* steps since the last refresh */
  int renewals;             /* of the mass matrix alone since D and K were calculated */
  int unchecked_steps;      /* steps since the contraction was measured */
  long long iterations, evaluations;
} flex_stages_record;

typedef struct {
  int n;
  const flex_tableau *tableau;
  flex_equations *equations;
  const flex_inputs *inputs;
  flex_stages_record *record;
  flex_newton_matrix matrix;

  /* error norm: sqrt(sum of position_weight dy^2 + rate_weight dv^2) */
  real *position_weight, *rate_weight;

  real pace; /* of each lane's own time */

  /* the unknowns, stages x n: prediction before, result after a solution */
  real *acceleration;

  /* scratch; inputs: stages x inputs */
  real *position, *rate, *residual, *u, *weight, *lanes;

  /* nodes of the stages side by side, and coefficients: of each stage's acceleration in the positions and rates of all */
  double nodes[FLEX_MAX_STAGES];
  double to_position[FLEX_MAX_STAGES][FLEX_MAX_STAGES], to_rate[FLEX_MAX_STAGES][FLEX_MAX_STAGES];
} flex_stages;

void flex_stages_take_state(flex_stages *stages, const flex_model *model, flex_arena *arena);
void flex_stages_take_scratch(flex_stages *stages, int n, int n_inputs, flex_arena *arena);

/* chooses the method; with another one, what is known about the matrix has to be forgotten */
void flex_stages_use(flex_stages *stages, const flex_tableau *tableau);
void flex_stages_clear(flex_stages *stages);

/* solves for the step from t to t + h, starting from the prediction in `acceleration`.
 * a0 is the acceleration at t, scale the size of the motion in the error norm; the error that is left in the end
 * positions and rates is at most `target` in the same norm. */
flex_outcome flex_stages_solve(flex_stages *stages, double t, double h, const real *y, const real *v, const real *a0,
                               real scale, double target);

/* size of a motion in the error norm, without the positions of locked unknowns */
real flex_motion_norm(const flex_stages *stages, const real *y, const real *v);

/* sqrt(sum of position_weight dy^2 + rate_weight dv^2), of the worst lane in units of its scale */
double flex_error_norm(const flex_stages *stages, const real *dy, const real *dv, real scale);

#endif

/* Static equilibrium: r(y, 0, 0, u) = 0 by damped Newton iterations, for the unknowns that aren't locked.
 *
 * The damping is the natural monotonicity test (Deuflhard: Newton Methods for Nonlinear Problems, section 3.3): the
 * correction that the old matrix gives at the new point must be smaller than the one that led there. */
#ifndef FLEXFMU_STATICS_H
#define FLEXFMU_STATICS_H

#include "equations.h"
#include "outcome.h"

typedef struct {
  real *zero, *trial, *residual, *correction, *simplified, *stiffness; /* n, the last n x n */
  int *pivots;
} flex_statics;

void flex_statics_take(flex_statics *statics, int n, flex_arena *arena);

/* replaces the guess y by the equilibrium for the inputs u. weight: share of each coordinate in the error norm, squared;
 * floor: size of a negligible deflection in that norm. The last correction's norm is reported. */
flex_outcome flex_statics_solve(flex_statics *statics, flex_equations *equations, const real *weight, real floor,
                                const real *u, real *y, double *last_correction);

/* forces r(y, 0, 0, u) on all unknowns at a point, in statics->residual */
int flex_statics_forces(flex_statics *statics, flex_equations *equations, const real *u, const real *y);

#endif

/* The generated functions of a model with their arguments packed: plain calls on vectors.
 *
 * Every function returns 0, or another number if the generated code refused to evaluate. */
#ifndef FLEXFMU_EQUATIONS_H
#define FLEXFMU_EQUATIONS_H

#include "memory.h"
#include "model.h"

typedef struct {
  const flex_model *model;
  const double *d; /* derived parameters */
  long long *evaluations;

  /* work space of the generated functions */
  const double **arg;
  double **res;
  int *iw;
  double *w;
} flex_equations;

void flex_equations_take(flex_equations *equations, const flex_model *model, flex_arena *arena);

/* r(y, v, a, u), n numbers; counted as an evaluation */
int flex_residual(flex_equations *equations, const double *y, const double *v, const double *a, const double *u, double *r);

/* M(y, u), n x n by columns */
int flex_mass_matrix(flex_equations *equations, const double *y, const double *u, double *mass);

/* singularity margin, one number */
int flex_margin(flex_equations *equations, const double *y, const double *u, double *margin);

/* any function of the model: up to 9 arguments, then the result */
int flex_call(flex_equations *equations, const flex_function *function, int n_arguments, const double *const *arguments,
              double *result);

/* arguments of residual and outputs, or their changes; a is held where changes are meant */
typedef struct {
  const double *y, *v, *a, *u, *d;
} flex_point;

/* how many numbers flex_motion_forward gives */
size_t flex_changes_count(const flex_model *model);

/* changes of residual and outputs with those of everything but the acceleration, and the entries of do/da */
int flex_motion_forward(flex_equations *equations, const flex_point *at, const flex_point *change, double *changes);

/* adds do/da a to changes of the outputs */
void flex_add_acceleration(const flex_model *model, const double *entries, const double *a, double *outputs);

#endif

/* The generated functions of a model with their arguments packed: plain calls on vectors.
 *
 * Every function returns 0, or another number if the generated code refused to evaluate. */
#ifndef FLEXFMU_EQUATIONS_H
#define FLEXFMU_EQUATIONS_H

#include "model.h"
#include "real.h"

typedef struct {
  const flex_model *model;
  real *d;  /* derived parameters */
  int *modes; /* of frictions and events, FLEX_FREE and so on */
  double *forgiven; /* by so much each event's number may be beyond zero on its side */
  long long *evaluations;

  /* forces with which frictions hold what sticks, at the last residual [n_frictions] */
  real *holding;
  int *earlier_modes; /* scratch */
  real *crossings, *fired; /* of the events: numbers and their rates; which reset states */
  int has_lanes;      /* the processor's registers can be used */

  /* work space of the generated functions */
  const real **arg;
  real **res;
  int *iw;
  real *w;
} flex_equations;

/* what a friction does: nothing of its own, since it has no force or the motion hasn't begun; holds; slips */
enum { FLEX_FREE, FLEX_STUCK, FLEX_FORWARD, FLEX_BACKWARD };

void flex_equations_take(flex_equations *equations, const flex_model *model, flex_arena *arena);

/* the mode of a friction, or of an event after all frictions, and the direction that the generated functions see; the latter again after `derive` */
void flex_set_mode(flex_equations *equations, int place, int mode);
void flex_show_modes(flex_equations *equations);

/* whether friction holds an unknown */
int flex_is_held(const flex_equations *equations, int unknown);

/* zero where friction holds an unknown: its equation doesn't change */
void flex_hold(const flex_equations *equations, real *rates);

/* r(y, v, a, u), n numbers, a itself where friction holds; counted as an evaluation */
int flex_residual(flex_equations *equations, const real *y, const real *v, const real *a, const real *u, real *r);

/* the same for `count` points side by side, four numbers for each coordinate; only where `flex_lanes_serve` */
int flex_lanes_serve(const flex_equations *equations);
void flex_residual_lanes(flex_equations *equations, int count, const real *y, const real *v, const real *a,
                         const real *u, real *r);

/* M(y, u), n x n by columns, rows and columns of the unit matrix where friction holds: these are put into one that has none yet */
int flex_mass_matrix(flex_equations *equations, const real *y, const real *u, real *mass);
void flex_hold_mass(const flex_equations *equations, real *mass);

/* singularity margin, the least of all lanes */
int flex_margin(flex_equations *equations, const real *y, const real *u, double *margin);

/* any function of the model: up to 9 arguments, then the result */
int flex_call(flex_equations *equations, const flex_function *function, int n_arguments, const real *const *arguments,
              real *result);

/* arguments of residual and outputs, or their changes; a is held where changes are meant */
typedef struct {
  const real *y, *v, *a, *u, *d;
} flex_point;

/* how many numbers flex_motion_forward gives */
size_t flex_changes_count(const flex_model *model);

/* changes of residual, zero where friction holds, and outputs with those of everything but the acceleration, and the entries
 * of do/da */
int flex_motion_forward(flex_equations *equations, const flex_point *at, const flex_point *change, real *changes);

/* adds do/da a to changes of the outputs */
void flex_add_acceleration(const flex_model *model, const real *entries, const real *a, real *outputs);

#endif

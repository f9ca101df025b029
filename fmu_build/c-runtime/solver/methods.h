/* The integration methods that there are, by the number under which the importer chooses one. */
#ifndef FLEXFMU_METHODS_H
#define FLEXFMU_METHODS_H

#include "outcome.h"
#include "tableaus.h"

/* values of the parameter `integrator` */
enum {
  FLEX_AUTOMATIC = 1,
  FLEX_GAUSS_2,
  FLEX_GAUSS_3,
  FLEX_GAUSS_4,
  FLEX_RADAU_3,
  FLEX_DORMAND_PRINCE,
  FLEX_RUNGE_KUTTA_4,
  FLEX_RADAU_3_DENSE,
  FLEX_LAST_INTEGRATOR = FLEX_RADAU_3_DENSE
};

typedef struct flex_integrator flex_integrator;

/* one step, or what a method prefers to it, from t to t + h, with a local error of at most `allowed` in the error norm;
 * value: number that belongs to a failure, after which everything but the step size to try next is as before */
typedef flex_outcome (*flex_step)(flex_integrator *integrator, double t, double h, double allowed, double *value);

typedef struct {
  int order;       /* of the solution's error over many steps, in powers of the step size */
  int local_order; /* of the controlled local error */
  flex_step step;
  const flex_tableau *collocation;           /* NULL for explicit methods */
  const flex_explicit_tableau *runge_kutta;  /* NULL for collocation */
  int looks_ahead; /* 1 = steps go beyond communication points, where the motion is interpolated; only if a stage is the end */
} flex_method;

/* the method of a number; FLEX_AUTOMATIC: the cheapest for the tolerance, of those that damp nothing where the model doesn't.
 * Overdamped: something decays far faster than it vibrates. Gauss methods keep what rounding and iteration leave there, which
 * the accelerations multiply by the rate of decay; Radau takes it out. */
const flex_method *flex_find_method(int number, double tolerance, int is_damped, int is_overdamped);

#endif

/* The contract between a generated trajectory and the runtime: a table of knots.
 *
 * Between two knots position, velocity and acceleration follow each its own polynomial of degree 9 through value and four
 * derivatives at both knots. A breakpoint has two knots of the same time: left limits in the first, right limits in the
 * second. Before the first knot and after the last there is standstill. Nothing here is ever written at run time. */
#ifndef FLEXFMU_TRAJECTORY_MODEL_H
#define FLEXFMU_TRAJECTORY_MODEL_H

#include "model.h"

enum {
  FLEX_KINDS = 3,                              /* position, velocity, acceleration */
  FLEX_END_ORDER = 4,                          /* derivatives of each that are met at the knots */
  FLEX_KNOT_ORDERS = FLEX_KINDS + FLEX_END_ORDER /* rows of a knot: position and derivatives 1 to 6 */
};

typedef struct {
  const char *name;
  const char *guid;

  int n_axes;
  int n_knots;                           /* at least two */
  const double *times;                   /* [s], n_knots, ascending */
  const double *jets;                    /* n_knots x FLEX_KNOT_ORDERS x n_axes */
  const flex_variable *output_variables; /* positions of all axes, velocities, accelerations */
} flex_trajectory_model;

/* the one trajectory of this binary, defined by the generated file */
FLEX_PRIVATE const flex_trajectory_model flex_the_trajectory;

#endif

/* Room for the directional derivatives of a plant: changes of everything that its outputs depend on. */
#ifndef FLEXFMU_TANGENT_H
#define FLEXFMU_TANGENT_H

#include "equations.h"
#include "memory.h"
#include "model.h"

typedef struct {
  real *p, *d, *y, *v, *u; /* changes, named like what changes */
  real *start;    /* changes of derived parameters and start coordinates with p, one after the other */
  real *rest_u;   /* changes of the inputs of the robot at rest */
  real *unit;     /* one coordinate changes at a time [n] */
  real *changes;  /* of residual and outputs, as flex_motion_forward gives them */
} flex_tangent;

void flex_tangent_take(flex_tangent *tangent, const flex_model *model, flex_arena *arena);

/* nothing changes */
void flex_tangent_clear(flex_tangent *tangent, const flex_model *model);

#endif

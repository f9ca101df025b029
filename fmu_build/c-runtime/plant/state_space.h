/* The plant as a system dx/dt = f(t, x, u) whose states the importer integrates: x = [y, v], without those that are no states. */
#ifndef FLEXFMU_STATE_SPACE_H
#define FLEXFMU_STATE_SPACE_H

#include "plant.h"

/* moves to another time; the inputs keep their values */
void flex_state_space_set_time(flex_plant *plant, double time);

/* moves to other states, which must be finite */
void flex_state_space_set(flex_plant *plant, const double *x);

/* present states; at the start of the motion those that initialisation finds */
flex_failure flex_state_space_get(flex_plant *plant, double *x);

/* dx/dt = [v, a] at the present point, which must not be too singular */
flex_failure flex_state_space_rates(flex_plant *plant, double *rates);

#endif

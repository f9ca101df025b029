/* A trajectory in time, evaluated on demand; at breakpoints the limit that is asked for. */
#ifndef FLEXFMU_TRAJECTORY_H
#define FLEXFMU_TRAJECTORY_H

#include "trajectory_model.h"

/* which limit is shown where the trajectory jumps */
typedef enum { FLEX_LEFT = 1, FLEX_RIGHT = 2 } flex_limit;

/* where breakpoints are within `slack` of a time, the first of them from the left, the last of them from the right; else
 * the time itself */
double flex_trajectory_landing(const flex_trajectory_model *model, double time, double slack, flex_limit limit);

/* the first breakpoint after a time, HUGE_VAL behind the last */
double flex_trajectory_next(const flex_trajectory_model *model, double time);

/* outputs and their derivatives up to FLEX_END_ORDER at a time: (FLEX_END_ORDER + 1) x FLEX_KINDS x n_axes */
void flex_trajectory_evaluate(const flex_trajectory_model *model, double time, flex_limit limit, double *signals);

#endif

/* Events of a model: numbers whose passage through zero changes the equations, by the side that these see, or the states.
 *
 * While a step is made, every number stays on its side. Its passage is found within the step (friction.c), which then ends there.
 * Where a reset turns the motion back at zero, as a bounce does, the number stays on its side, and what it was beyond zero is forgiven.
 * A number that jumps beyond zero has passed, wherever it then goes. */
#ifndef FLEXFMU_EVENTS_H
#define FLEXFMU_EVENTS_H

#include "integrator.h"

/* the least of all numbers at a point, each positive on its side; HUGE_VAL without events */
flex_outcome flex_events_least(const flex_integrator *integrator, const real *y, const real *v, const real *a,
                               const real *u, double *least);

/* when the next of the numbers that move at a constant rate passes zero; HUGE_VAL if none does */
double flex_events_next(const flex_integrator *integrator, const real *u, double time);

/* sides at the present point, whose acceleration is there, and resets of what has passed through zero; *changed = 1 if there was one */
flex_outcome flex_events_settle(flex_integrator *integrator, const real *u, int *changed);

/* the numbers of the present point, for importers that look for events themselves */
flex_outcome flex_events_indicators(const flex_integrator *integrator, const real *u, double *indicators);

#endif

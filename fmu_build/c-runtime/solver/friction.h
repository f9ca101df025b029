/* Dry friction that sticks: modes, and the events at which they change.
 *
 * A friction holds its unknown (a = 0) while the force that this takes is at most the breakaway force; it slips in one
 * direction until the rate passes through zero. Within a mode the equations are smooth. Both events are found within the step
 * in which they happen; the step is made again so that it ends there.
 *
 * Sources: Karnopp, Computer simulation of stick-slip friction in mechanical dynamic systems, J. Dyn. Syst. Meas. Control 107
 * (1985); Pfeiffer and Glocker, Multibody dynamics with unilateral contacts (1996). */
#ifndef FLEXFMU_FRICTION_H
#define FLEXFMU_FRICTION_H

#include "integrator.h"

/* modes that belong to the present y, v and inputs u, with acceleration and factor of the mass matrix. What has passed through
 * rest since its mode was chosen is stopped; *stopped = 1 if anything was */
flex_outcome flex_friction_settle(flex_integrator *integrator, const real *u, int *stopped);

/* a step of the method from t to t + *h, or to the first event in between: then *h becomes shorter, and the modes are those
 * after the event; attempts: counts the steps that finding it takes */
flex_outcome flex_friction_step(flex_integrator *integrator, double t, double *h, double allowed, double *attempts,
                                double *value);

/* a number for every friction that is positive while its mode is right, for importers that look for events themselves: a
 * little above zero where the mode begins. The acceleration must be there */
flex_outcome flex_friction_indicators(flex_integrator *integrator, const real *u, double *indicators);

#endif

/* What the methods share in making one step of the integrator. */
#ifndef FLEXFMU_INTEGRATION_STEP_H
#define FLEXFMU_INTEGRATION_STEP_H

#include "integrator.h"
#include "lanes.h"

/* steps of the two families of methods */
flex_outcome flex_collocation_step(flex_integrator *integrator, double t, double h, double allowed, double *value);
flex_outcome flex_explicit_step(flex_integrator *integrator, double t, double h, double allowed, double *value);

/* the first once more, for processors with lanes (lanes_collocation.c) */
flex_outcome flex_collocation_step_wide(flex_integrator *integrator, double t, double h, double allowed, double *value);

/* step after one whose equations could not be solved */
#define FLEX_FAILED_SHRINK 0.3

/* least shrinking of a step that was too inaccurate, and of one that two halves could not save */
#define FLEX_INACCURATE_SHRINK 0.9
#define FLEX_HALVED_SHRINK 0.5

/* size of a difference that the last digits of positions and rates make: a slow motion far from the origin has a small scale, and
 * shorter steps don't help. Overwrites full_y and full_v */
double flex_step_rounding(flex_integrator *integrator);

/* keeps the motion at the start of a step */
void flex_step_save(flex_integrator *integrator);

/* back to what was saved, with a smaller step to come; returns the outcome */
flex_outcome flex_step_reject(flex_integrator *integrator, const flex_integrator_record *before, double step,
                              flex_outcome outcome);

/* adds the change over a step to one coordinate, without losing what rounding leaves of it */
void flex_step_move(flex_integrator *integrator, int coordinate, real dy, real dv);

/* factor of the mass matrix for positions y and inputs u */
flex_outcome flex_step_factor(flex_integrator *integrator, const real *y, const real *u);

/* the same and the acceleration a, with rates v; a: a guess before */
flex_outcome flex_step_accelerate(flex_integrator *integrator, const real *y, const real *v, const real *u, real *a);

/* goes on with other equations: what the steps so far say about them is forgotten */
void flex_step_restart(flex_integrator *integrator);

/* acceleration and factor of the mass matrix at the present y and v for the inputs u */
flex_outcome flex_step_accelerate_present(flex_integrator *integrator, const real *u);

/* margin of the mechanism at the present position for the inputs u */
flex_outcome flex_step_check_margin(flex_integrator *integrator, const real *u, double *margin);

/* keeps a step whose stages are solved for interpolation, before the motion goes to its end */
void flex_integrator_keep_segment(flex_integrator *integrator, double t, double h);

/* where sizes grow: those of the error norm, at least the present coordinates and rates */
void flex_step_grow_sizes(flex_integrator *integrator);

/* counts a step whose end was reached with everything belonging to it, and follows the size of the motion */
void flex_step_count(flex_integrator *integrator);

#endif

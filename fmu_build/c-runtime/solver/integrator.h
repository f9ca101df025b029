/* Integration of r(y, y', y'', u(t)) = 0 by one of several methods, with control of the local error or by fixed steps. */
#ifndef FLEXFMU_INTEGRATOR_H
#define FLEXFMU_INTEGRATOR_H

#include "accuracy.h"
#include "methods.h"
#include "stages.h"

/* plain numbers, saved and restored with the state of the plant */
typedef struct {
  flex_accuracy accuracy;
  double step;         /* step size that the error admits [s]; 0 = not known */
  real scale;          /* running maximum of the motion in the error norm */
  double history_step; /* duration of the step that is kept for prediction [s]; 0 = none */
  int is_factored;     /* 1 = the factor of the mass matrix belongs to the present y */
  long long steps, rejections;
  int is_ahead;    /* 1 = the last step has gone beyond the present time */
  double far;      /* its end [s] */
  double begin[2], length[2]; /* of the last two steps [s], for interpolation */
  int at_event; /* 1 = the last step has ended at an event that isn't handled yet */
  int modes_are_held; /* 1 = the modes of friction and events change at the importer's events only */
  int patience, drops; /* communication steps that end a step before the next one looks ahead; drops in a row */
} flex_integrator_record;

struct flex_integrator {
  int n;
  const flex_method *method;
  flex_step step; /* the method's, compiled for this processor */
  int looks_ahead;
  double tolerance;
  double local_error; /* that a step may make, relative to the size of the motion */
  flex_stages stages;
  flex_integrator_record *record;
  const real *floor;      /* least scale */
  const double *fixed_step; /* [s]; 0 = the error decides */
  double work_left;         /* evaluations that may still be made; not given back with a saved state */
  int stops_at_events;      /* 1 = integration ends at the first event, which the importer handles */
  void (*completed)(flex_integrator *integrator, double time); /* follows each step, and may make an event of its end; NULL for none */
  int wants_longer_steps;   /* 1 = a step is shorter than what is left of the communication step */

  /* numeric state, one after the other in memory: position, rate, what rounding left of both, acceleration, accelerations
   * at the start, the stages and the end of the last step [(stages + 2) n], factor of the mass matrix */
  real *y, *v, *y_rest, *v_rest, *a, *history, *mass_factor;
  size_t motion_count;

  /* numeric state of methods that look ahead: position, rate and accelerations at the start and the stages of the last two steps
   * [2 (stages + 3) n], the motion and its inputs at the end of the step that has gone beyond the present time */
  real *segments, *far_motion, *far_u;

  /* scratch; explicit methods: rates and accelerations of the stages */
  real *saved, *full_y, *full_v, *full_a, *change, *defect, *end_u, *explicit_y, *explicit_v, *explicit_a;
};

void flex_integrator_take_state(flex_integrator *integrator, const flex_model *model, flex_arena *arena);
void flex_integrator_take_scratch(flex_integrator *integrator, int n, int n_inputs, flex_arena *arena);

/* chooses the method and the relative tolerance; with another one, what is known about steps has to be forgotten */
void flex_integrator_use(flex_integrator *integrator, const flex_method *method, double tolerance);

/* whether a step that has gone beyond the present time still holds: its inputs, now `before`, are those that were set since, now u,
 * but for a share of the tolerance; where it doesn't hold, it is dropped */
int flex_integrator_foresaw(flex_integrator *integrator, const real *before, const real *u);
void flex_integrator_drop(flex_integrator *integrator);

/* begins a motion at the present y and v: forgets history and step size */
void flex_integrator_start(flex_integrator *integrator);

/* makes the factor of the mass matrix valid at the present y for the inputs u */
flex_outcome flex_integrator_factor(flex_integrator *integrator, const real *u);

/* integrates from t0 to t1, or to the first event; a must be the acceleration at t0. Returns the outcome with the time
 * that was reached; y, v, a belong to that time. */
flex_failure flex_integrator_advance(flex_integrator *integrator, double t0, double t1);

#endif

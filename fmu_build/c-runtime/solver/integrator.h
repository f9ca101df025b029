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
} flex_integrator_record;

struct flex_integrator {
  int n;
  const flex_method *method;
  flex_step step; /* the method's, compiled for this processor */
  double local_error; /* that a step may make, relative to the size of the motion */
  flex_stages stages;
  flex_integrator_record *record;
  const real *floor;      /* least scale */
  const double *fixed_step; /* [s]; 0 = the error decides */
  double work_left;         /* evaluations that may still be made; not given back with a saved state */
  int wants_longer_steps;   /* 1 = a step is shorter than what is left of the communication step */

  /* numeric state, one after the other in memory: position, rate, what rounding left of both, acceleration, accelerations
   * at the start, the stages and the end of the last step [(stages + 2) n], factor of the mass matrix */
  real *y, *v, *y_rest, *v_rest, *a, *history, *mass_factor;
  size_t motion_count;

  /* scratch; explicit methods: rates and accelerations of the stages */
  real *saved, *full_y, *full_v, *full_a, *change, *defect, *end_u, *explicit_y, *explicit_v, *explicit_a;
};

void flex_integrator_take_state(flex_integrator *integrator, int n, flex_arena *arena);
void flex_integrator_take_scratch(flex_integrator *integrator, int n, int n_inputs, flex_arena *arena);

/* chooses the method and the relative tolerance; with another one, what is known about steps has to be forgotten */
void flex_integrator_use(flex_integrator *integrator, const flex_method *method, double tolerance);

/* begins a motion at the present y and v: forgets history and step size */
void flex_integrator_start(flex_integrator *integrator);

/* makes the factor of the mass matrix valid at the present y for the inputs u */
flex_outcome flex_integrator_factor(flex_integrator *integrator, const real *u);

/* integrates from t0 to t1; a must be the acceleration at t0. Returns the outcome with the time
 * that was reached; y, v, a belong to that time. */
flex_failure flex_integrator_advance(flex_integrator *integrator, double t0, double t1);

#endif

/* What can happen while computing. */
#ifndef FLEXFMU_OUTCOME_H
#define FLEXFMU_OUTCOME_H

typedef enum {
  FLEX_DONE = 0,
  FLEX_INACCURATE,     /* the estimated error exceeds the tolerance */
  FLEX_NO_CONVERGENCE, /* the stage equations were not solved */
  FLEX_NOT_FINITE,     /* the model returned NaN or infinity */
  FLEX_NOT_DEFINITE,   /* the mass matrix is not positive definite */
  FLEX_TOO_SINGULAR,   /* the margin of the mechanism is violated */
  FLEX_TOO_MANY_STEPS, /* the end of the communication step is out of reach */
  FLEX_TOO_MUCH_WORK,  /* far more evaluations of the equations than a motion of this length takes */
  FLEX_NO_EQUILIBRIUM, /* Newton's method found no static equilibrium */
  FLEX_BAD_SCALE,      /* the error norm of the model is unusable */
  FLEX_STEP_TOO_LONG,  /* the equations could not be solved with the fixed step */
  FLEX_EVENTS_ACCUMULATE /* an event follows itself in ever shorter time */
} flex_outcome;

/* an outcome with the place where it happened */
typedef struct {
  flex_outcome outcome;
  double time;  /* [s] */
  double value; /* of the margin, the step size or whatever the outcome is about */
} flex_failure;

#endif

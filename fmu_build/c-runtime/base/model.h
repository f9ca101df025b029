/* The contract between a generated model and the runtime.
 *
 * A model is a constant description (this header) plus generated functions. Its equations are of second order in n
 * unknown coordinates y, driven by m inputs u and by n_derived parameters d that follow from the FMI parameters p:
 *
 *     r(y, v, a, u, d) = M(y, u, d) a + b(y, v, u, d) = 0,     v = dy/dt, a = dv/dt.
 *
 * All vectors and matrices are dense; matrices are stored by columns. Nothing here is ever written at run time. */
#ifndef FLEXFMU_MODEL_H
#define FLEXFMU_MODEL_H

#include "private.h"
#include "real.h"

/* signature of every function that CasADi generates (casadi_real = real, casadi_int = int) */
typedef int (*flex_casadi_call)(const real **arg, real **res, int *iw, real *w, int mem);

/* a generated function with the sizes of the work arrays that it needs */
typedef struct {
  flex_casadi_call call;
  int n_arg, n_res, n_iw, n_w;
} flex_function;

/* a scalar real variable as FMI shows it; minimum and maximum are -HUGE_VAL and HUGE_VAL where there is no limit */
typedef struct {
  const char *name;
  const char *unit;
  double start, minimum, maximum;
  int tunable; /* parameters: 1 = may change between communication steps, 0 = fixed after initialisation */
} flex_variable;

/* an entry of do/da: this output depends on the acceleration of this unknown */
typedef struct {
  int output, unknown;
} flex_term;

/* dry friction that can hold an unknown: while it slips, its generalised force enters the residual of its own row, with the
 * direction d[direction]; while it sticks, that row is a = 0 instead. `derive` leaves the direction at 0, which stands for the
 * rate's own sign */
typedef struct {
  int unknown;
  int breakaway; /* d[breakaway]: the largest force that holds it */
  int direction; /* d[direction]: 1 or -1 while it slips */
} flex_friction;

/* a number whose passage through zero is an event */
typedef struct {
  int side;      /* d[side]: 1 or -1, the number's sign, which changes at its passages only; `derive` leaves it at 0 */
  int direction; /* of the passages that reset states: 1 upwards, -1 downwards, 0 both */
  int has_reset;
  int is_instant; /* it moves at a constant rate between events: the time of its next passage is known */
  int at_start;   /* it passes at the start where it is beyond zero there already: a sample */
} flex_event;

/* a matrix whose entries are stored by columns without most zeros, and its factors in the place of these */
typedef struct {
  int count;                                    /* entries */
  const int *diagonals;                         /* which of them are on the diagonal */
  int (*factor)(int is_complex, real *a, real *x);          /* x is scratch; 0, or 1 if a pivot is zero or not finite */
  void (*solve)(int is_complex, const real *lu, real *x);   /* x = inverse(A) x */
  void (*multiply)(const real *a, const real *x, real *y);  /* y = A x; y is not x */
} flex_sparse;

typedef struct {
  const char *name;
  const char *guid;

  int n;            /* unknown coordinates; 0 is valid (a rigid model) */
  int n_locked;     /* the first unknowns are actuated: given at the start, held there while the others find their static
                       equilibrium; each belongs to the input of the same index, a generalised force that enters the
                       residual with the factor -1 and holds the equilibrium unless it is set */
  int n_first;      /* so many unknowns after the others are of first order: their rates v are the states, and nothing depends
                       on their coordinates y, the integrals of these */
  int has_clock;    /* 1 = the last unknown is the time: y = t, v = 1; it is no state */
  int n_start;      /* numbers that `initial_coordinates` gives: n at rest, 2 n with the rates */
  int n_inputs;     /* m */
  int n_rate_inputs; /* the last inputs are rates, zero at rest: the static equilibrium doesn't see them */
  int n_parameters; /* FMI parameters p */
  int n_derived;    /* derived parameters d */
  int n_outputs;
  int max_input_order; /* highest order that fmi2SetRealInputDerivatives accepts */

  const flex_variable *input_variables, *parameter_variables, *output_variables;

  const int *state_outputs;     /* which output shows each of the states, coordinates then rates; NULL if none does */
  const double *state_nominals; /* their usual sizes, positive; NULL for 1 */

  int n_acceleration_terms;
  const flex_term *acceleration_terms; /* the entries of do/da that motion_forward gives; NULL if there are none */

  int n_frictions;
  const flex_friction *frictions; /* NULL if there are none */

  int n_events;
  const flex_event *events; /* NULL if there are none */

  int n_pose;              /* outputs that tell a person where the mechanism is, for messages */
  const int *pose_outputs; /* which they are; NULL if there are none */

  int static_start;          /* start value of `initial`: 1 = static equilibrium, 0 = undeformed */
  int is_damped;             /* 1 = something takes energy out of the vibrations */
  int sizes_grow;            /* 1 = the weights of `error_scale` are 1 / size^2, with sizes that grow with the motion */
  double default_tolerance;  /* relative tolerance where fmi2SetupExperiment gives none */
  double minimum_margin;     /* smallest admissible value of `singularity` */
  const char *margin_name;   /* what `singularity` measures, for messages */
  const char *events_text;   /* names of the events, for messages; NULL if there are none */
  const char *iterated;      /* variables for which the equations solve by iteration, for messages; NULL if there are none */

  flex_function derive;         /* (p) -> d */
  flex_function initial_inputs; /* (p) -> u: inputs at the start pose, for inputs that were never set */
  flex_function initial_coordinates; /* (p) -> y at the start, undeformed; [y, v] where n_start is 2 n */
  flex_function residual;       /* (y, v, a, u, d) -> r [n] */
  /* the residual of four points side by side: four numbers for each coordinate and input. NULL where the compiler or the
   * equations have no lanes */
  void (*residual_lanes)(const double *y, const double *v, const double *a, const double *u, const double *d, double *r);
  flex_function mass_matrix;    /* (y, u, d) -> M [n x n], symmetric, positive definite */
  flex_function outputs;        /* (y, v, a, u, d) -> o [n_outputs] */

  /* Newton's matrix where it is sparse: entries of M, D and K = dr/da, dr/dv, dr/dy. NULL where matrices are dense */
  const flex_sparse *sparse;
  flex_function jacobian;       /* (y, v, a, u, d) -> M, D, K; only where there is `sparse` */

  /* directional derivatives: what small changes dy, dv, .. of the arguments make of the results. Residual and outputs
   * share most of their operations, so one function gives both, without what changes of the acceleration add: M da to dr,
   * do/da da to do. */
  flex_function motion_forward; /* (y, v, a, u, d, dy, dv, du, dd) -> [dr (n), do (n_outputs), entries of do/da] */
  flex_function start_forward;  /* (p, dp) -> [dd, dy] of derive and initial_coordinates, with dv where that gives v */

  /* time derivatives along the motion without what the jerk j = da/dt adds, M j and do/da j; u1 = du/dt */
  flex_function motion_rate1; /* (y, v, a, u, u1, d) -> [dr/dt (n), do/dt (n_outputs), entries of do/da] */

  /* second time derivatives along the motion without what the snap s = d2a/dt2 adds: M s and do/da s; u2 = d2u/dt2 */
  flex_function motion_rate2; /* (y, v, a, u, u1, d, j, u2) -> [d2r/dt2 (n), d2o/dt2 (n_outputs)] */

  int rates_share; /* 1 = motion_rate1 gives M and o too, behind its results, and motion_rate2 relies on what it left in w */

  /* events: numbers, and their time derivatives along the motion with the inputs held; the states behind those events k whose
   * fired[k] is 1. Only where there are events */
  flex_function event_numbers; /* (y, v, a, u, d) -> [g (n_events), dg/dt (n_events)] */
  flex_function event_resets;  /* (y, v, u, d, fired) -> [y, v] */

  flex_function singularity; /* (y, u, d) -> one number, at least minimum_margin at admissible poses, NaN where the
                                mechanism cannot be assembled */
  flex_function error_scale; /* (d) -> [kappa (n), mu (n), floor]: error norm = sqrt(sum kappa_i dy_i^2 + mu_i dv_i^2),
                                relative to the running maximum of the motion's own norm, at least floor; positions of
                                locked unknowns have an arbitrary origin and don't count in that maximum */
} flex_model;

/* how many coordinates, and how many rates, are states: those of the first unknowns */
static inline int flex_state_coordinates(const flex_model *model) { return model->n - model->n_first - model->has_clock; }
static inline int flex_state_rates(const flex_model *model) { return model->n - model->has_clock; }

/* what has a mode: frictions, then events */
static inline int flex_switches(const flex_model *model) { return model->n_frictions + model->n_events; }

/* the one model of this binary, defined by the generated file */
FLEX_PRIVATE const flex_model flex_the_model;

#endif

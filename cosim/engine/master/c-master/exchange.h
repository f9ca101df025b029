/* Integrates the states of an FMU for model exchange up to its next event: Radau IIA of order 5 with control of the local error.
 *
 * E. Hairer, G. Wanner: Solving Ordinary Differential Equations II, section IV.8. Dense matrices, stored by rows. */
#ifndef FLEXFMU_EXCHANGE_H
#define FLEXFMU_EXCHANGE_H

#include "master.h"

/* what master_exchange_advance returns */
enum {
  EXCHANGE_REACHED, /* the time asked for */
  EXCHANGE_EVENT,   /* a state event or step event */
  EXCHANGE_ENDS,    /* the FMU ends the simulation */
  EXCHANGE_STUCK,   /* the steps became too short: the FMU discards its equations, or they have no solution */
  EXCHANGE_FAILED   /* a function of the FMU failed: `status` */
};

/* what a saved state has beside `memory` */
typedef struct {
  double time, begin;      /* end and begin of the last step [s] */
  double step;             /* that the error admits [s]; 0 = not known */
  double last, last_error; /* length of the last step [s], 0 = none, and its error relative to the tolerance */
  double factored;         /* length of the step to which the factors belong [s]; 0 = none */
  int is_current;          /* 1 = the Jacobian belongs to the present states */
  int is_stale;            /* 1 = the Jacobian has to be renewed */
} master_exchange_record;

/* inputs that follow polynomials of the time since `begin`: coefficients[power][input] */
typedef struct {
  const unsigned *references;
  size_t references_count, count, powers;
  const double *coefficients;
  double *values;
  double begin; /* [s] */
} master_exchange_polynomials;

typedef struct {
  void *const *component; /* where the handle of the FMU's instance is */
  int (*set_time)(void *, double);
  int (*set_states)(void *, const double *, size_t);
  int (*get_rates)(void *, double *, size_t);
  int (*get_indicators)(void *, double *, size_t);
  void (*completed)(void);   /* fmi2- or fmi3CompletedIntegratorStep; NULL where it isn't needed */
  void (*directional)(void); /* fmi2- or fmi3GetDirectionalDerivative; NULL for differences */
  void (*set_real)(void);    /* fmi2SetReal or fmi3SetFloat64 */
  const master_exchange_polynomials *polynomials; /* inputs that aren't held */
  size_t polynomials_count;
  const unsigned *unknown, *known; /* value references of derivatives and states */
  size_t references;
  int is_fmi3;
  size_t n, m; /* states, event indicators */
  double tolerance; /* relative */
  double least;     /* shortest step [s] */
  int no_rollback;  /* 1 = no state from before will be restored */
  const double *absolute, *nominal; /* tolerance and usual size of each state */
  double *memory;                   /* master_exchange_size doubles */
  int *pivots;                      /* 2 n */
  master_exchange_record record;
  int status; /* of the FMU's last function */
} master_exchange;

/* doubles that n states and m event indicators take */
EXPORTED size_t master_exchange_size(size_t n, size_t m);

/* begins or goes on at the states x and the time of the record: `anew` forgets step and Jacobian. Returns EXCHANGE_REACHED or what
 * failed */
EXPORTED int master_exchange_begin(master_exchange *exchange, const double *x, int anew);

/* integrates up to `bound` or the first event; afterwards the FMU has the states and the time of the record */
EXPORTED int master_exchange_advance(master_exchange *exchange, double bound);

#endif

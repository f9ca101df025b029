/* Integrates the states of an FMU for model exchange up to its next event, by the solver of our own FMUs: Radau IIA of order 5. */
#ifndef FLEXFMU_EXCHANGE_H
#define FLEXFMU_EXCHANGE_H

#include <stddef.h>

#include "private.h"

/* what flex_exchange_advance returns */
enum {
  EXCHANGE_REACHED, /* the time asked for */
  EXCHANGE_EVENT,   /* a state event or step event */
  EXCHANGE_ENDS,    /* the FMU ends the simulation */
  EXCHANGE_STUCK,   /* the steps became too short: the FMU discards its equations, or they have no solution */
  EXCHANGE_FAILED   /* a function of the FMU failed: `status` */
};

/* inputs that follow polynomials of the time since `begin`: coefficients[power][input] */
typedef struct {
  const unsigned *references;
  size_t references_count, count, powers;
  const double *coefficients;
  double *values;
  double begin; /* [s] */
} flex_exchange_polynomials;

typedef struct {
  void *const *component; /* where the handle of the FMU's instance is */
  int (*set_time)(void *, double);
  int (*set_states)(void *, const double *, size_t);
  int (*get_states)(void *, double *, size_t);
  int (*get_nominals)(void *, double *, size_t);
  int (*get_rates)(void *, double *, size_t);
  int (*get_indicators)(void *, double *, size_t);
  void (*completed)(void);   /* fmi2- or fmi3CompletedIntegratorStep; NULL where it isn't needed */
  void (*directional)(void); /* fmi2- or fmi3GetDirectionalDerivative; NULL for differences */
  void (*set_real)(void);    /* fmi2SetReal or fmi3SetFloat64 */
  const flex_exchange_polynomials *polynomials; /* inputs that aren't held */
  size_t polynomials_count;
  const unsigned *unknown, *known; /* value references of derivatives and states */
  size_t references;
  int is_fmi3;
  size_t n, m; /* states, event indicators */
  double tolerance; /* relative */
  double time;      /* that is reached [s] */
  int no_rollback;  /* 1 = no state from before will be restored */
  void *memory;     /* flex_exchange_size bytes, zeros at first: all that belongs to a saved state, but for the time */
  void *plant;      /* in the memory; NULL before the first begin */
  int status;       /* of the FMU's last function */
  int ends;         /* 1 = the FMU ends the simulation */
} flex_exchange;

/* bytes that n states and m event indicators take */
FLEX_EXPORTED size_t flex_exchange_size(size_t n, size_t m);

/* begins or goes on at the FMU's time: `anew` with its states and without what is known about steps. Returns EXCHANGE_REACHED or
 * what failed */
FLEX_EXPORTED int flex_exchange_begin(flex_exchange *exchange, int anew);

/* integrates up to `bound` or the first event; afterwards the FMU has the states and the time that are reached */
FLEX_EXPORTED int flex_exchange_advance(flex_exchange *exchange, double bound);

#endif

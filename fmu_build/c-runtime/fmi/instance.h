/* An FMI instance: what it wraps, the importer's callbacks and what is logged. */
#ifndef FLEXFMU_INSTANCE_H
#define FLEXFMU_INSTANCE_H

#include "backend.h"
#include "fmi2_version.h"
#include "memory.h"
#include "model_exchange.h"
#include "private.h"
#include "refusal.h"

/* call_fmi2DoStep and so on */
typedef enum {
#define X(function, kinds, phases) call_##function,
  FLEX_FMI2_CALLS(X)
#undef X
} flex_call_id;

/* log categories, as the model description lists them */
typedef enum { LOG_ERROR, LOG_WARNING, LOG_DISCARD, LOG_FATAL, LOG_STATISTICS, N_LOG_CATEGORIES } flex_log_category;

FLEX_PRIVATE const char *const flex_log_categories[N_LOG_CATEGORIES];

/* the part of an instance's state that only this layer knows; saved and restored with the rest */
typedef struct {
  double stop_time;
  int has_stop_time;
  int phase;
  int kind;       /* what the instance was made for */
  int last_step;  /* FMI 2.0: status of the last step */
  int has_events; /* FMI 3.0, co-simulation: 1 = the importer uses event mode */
  int returns_early; /* steps may end early */
} flex_session;

typedef struct {
  flex_backend *backend;
  flex_session session;
  flex_callbacks callbacks;
  const char *name;
  int logged[N_LOG_CATEGORIES];   /* 1 = the category is shown */
  double *scratch;                /* FMI 3.0: as many numbers as there are outputs, event indicators, and inputs within a step */
  double *asked;                  /* FMI 3.0: within it, the inputs of an intermediate update */
  void *before;                   /* FMI 3.0: behind it, numeric state at the beginning of a step, for one that is discarded */
  void *freed_states;             /* memory of freed FMU states, for the next ones */
  char reason[FLEX_MESSAGE_SIZE]; /* FMI 2.0: why the last step was discarded, if it was and no state was restored since */
} flex_instance;

/* hands a sentence to the importer's logger, if its category is shown; returns the status */
fmi2Status flex_log(const flex_instance *instance, fmi2Status status, flex_log_category category, const char *format, ...);

/* the same with the backend's own message, as an error */
fmi2Status flex_log_refusal(const flex_instance *instance);

/* the instance behind a pointer if the call is legal in its state, else NULL after logging why not */
flex_instance *flex_checked(fmi2Component component, flex_call_id call);

/* 1 after logging it, if a call that is about `count` elements was given no place where they are */
int flex_lacks(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count);

/* 1 after logging it, if an array is missing or has another number of elements than it must have */
int flex_misfits(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count,
                 size_t needed);

/* a call that does no more than lead to another state */
fmi2Status flex_enter_phase(fmi2Component component, flex_call_id call, flex_phase phase);

/* a new instance; NULL after logging why there is none */
flex_instance *flex_instantiate(const char *name, flex_kind kind, const char *guid, int is_logging,
                                const flex_callbacks *callbacks);

/* before initialisation: tolerance, where one is given, start time and stop time */
fmi2Status flex_set_up(flex_instance *instance, int has_tolerance, double tolerance, double start, int has_stop, double stop);

/* 1 after logging it, if a communication step cannot be made at all */
int flex_step_is_impossible(const flex_instance *instance, double point, double step);

/* gives back the memory of freed FMU states */
void flex_release_states(flex_instance *instance);

/* 1 after logging it, if an output is among the variables before initialisation, when nothing is computed */
int flex_reads_too_early(const flex_instance *instance, const fmi2ValueReference *references, size_t count);

/* 1 after logging it, if an array of directional derivatives is missing or has another number of elements than it must have */
int flex_lacks_derivatives(const flex_instance *instance, flex_call_id call, const flex_direction *direction, const double *seed,
                           size_t n_seed, size_t seeds, const double *result, size_t n_result, size_t results);

#endif

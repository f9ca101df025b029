/* An FMI 3.0 instance: what it wraps, the importer's callback and what is logged. */
#ifndef FLEXFMU_FMI3_INSTANCE_H
#define FLEXFMU_FMI3_INSTANCE_H

#include <stdlib.h>

#include "fmi3Functions.h"
#include "fmi3_backend.h"
#include "fmi3_states.h"
#include "memory.h"
#include "model_exchange.h"
#include "private.h"
#include "refusal.h"

/* log categories, as the model description lists them */
typedef enum { LOG_ERROR, LOG_WARNING, LOG_DISCARD, LOG_FATAL, LOG_STATISTICS, N_LOG_CATEGORIES } flex_log_category;

FLEX_PRIVATE const char *const flex_log_categories[N_LOG_CATEGORIES];

/* The upper bits of a value reference tell what it is, the lower ones which: reals and integers by the backend's own numbers, of an
 * input an array with its derivatives of orders 1, 2, .. */
enum { FLEX_REAL, FLEX_INTEGER, FLEX_TIME, FLEX_INDICATOR, FLEX_INPUT_DERIVATIVES };

#define FLEX_SORT_OF(reference) ((reference) >> 28)
#define FLEX_INDEX_OF(reference) ((reference) & 0x0fffffffu)

/* the part of an instance's state that only this layer knows; saved and restored with the rest */
typedef struct {
  double stop_time;
  int has_stop_time;
  int phase;
  int kind;       /* what the instance was made for */
  int has_events; /* co-simulation: 1 = the importer uses event mode */
} flex_session;

typedef struct {
  flex_backend *backend;
  flex_session session;
  fmi3InstanceEnvironment environment;
  fmi3LogMessageCallback logger;
  int logged[N_LOG_CATEGORIES]; /* 1 = the category is shown; errors always are */
  double *scratch;              /* as many numbers as there are outputs and event indicators */
  void *before;                 /* numeric state at the beginning of a step, for one that is discarded */
  void *freed_states;           /* memory of freed FMU states, for the next ones */
} flex_instance;

/* hands a sentence to the importer's logger, if its category is shown; returns the status */
fmi3Status flex_log(const flex_instance *instance, fmi3Status status, flex_log_category category, const char *format, ...);

/* the same with the backend's own message, as an error */
fmi3Status flex_log_refusal(const flex_instance *instance);

/* the instance if the call is legal in its state, else NULL after logging why not */
flex_instance *flex_checked(fmi3Instance pointer, flex_call_id call);

/* 1 after logging it, if a call that is about `count` elements was given no place where they are */
int flex_lacks(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count);

/* 1 after logging it, if an array has another number of elements than it must have, or is missing */
int flex_misfits(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count,
                 size_t needed);

void flex_enter_phase(flex_instance *instance, flex_phase phase);

/* gives back the memory of freed FMU states */
void flex_release_states(flex_instance *instance);

#endif

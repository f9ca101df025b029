/* An FMI instance: what it wraps, the importer's callbacks and what is logged. */
#ifndef FLEXFMU_FMI2_INSTANCE_H
#define FLEXFMU_FMI2_INSTANCE_H

#include "backend.h"
#include "fmi2Functions.h"
#include "fmi2_states.h"
#include "memory.h"
#include "private.h"
#include "refusal.h"

/* log categories, as the model description lists them */
typedef enum { LOG_ERROR, LOG_WARNING, LOG_DISCARD, LOG_FATAL, LOG_STATISTICS, N_LOG_CATEGORIES } flex_log_category;

FLEX_PRIVATE const char *const flex_log_categories[N_LOG_CATEGORIES];

/* the part of an instance's state that only this layer knows; saved and restored with the rest */
typedef struct {
  double stop_time;
  int has_stop_time;
  int phase;
  int last_step; /* status of the last fmi2DoStep */
  int kind;      /* what the instance was made for */
} flex_session;

typedef struct {
  flex_backend *backend;
  flex_session session;
  fmi2CallbackFunctions callbacks;
  const char *name;
  int logged[N_LOG_CATEGORIES];   /* 1 = the category is shown */
  void *freed_states;             /* memory of freed FMU states, for the next ones */
  char reason[FLEX_MESSAGE_SIZE]; /* why the last fmi2DoStep was discarded, if it was and no state was restored since */
} flex_instance;

/* hands a sentence to the importer's logger, if its category is shown; returns the status */
fmi2Status flex_log(const flex_instance *instance, fmi2Status status, flex_log_category category, const char *format, ...);

/* the same with the backend's own message, as an error */
fmi2Status flex_log_refusal(const flex_instance *instance);

/* the instance behind a component if the call is legal in its state, else NULL after logging why not */
flex_instance *flex_checked(fmi2Component component, flex_call_id call);

/* 1 after logging it, if a call that is about `count` elements was given no place where they are */
int flex_lacks(const flex_instance *instance, flex_call_id call, const char *what, const void *place, size_t count);

flex_phase flex_phase_of(const flex_instance *instance);
void flex_enter_phase(flex_instance *instance, flex_phase phase);

/* memory through the importer's callbacks, or the C library where it has none */
void *flex_allocate(const fmi2CallbackFunctions *callbacks, size_t size);
void flex_release(const fmi2CallbackFunctions *callbacks, void *memory);

/* gives back the memory of freed FMU states */
void flex_release_states(flex_instance *instance);

#endif

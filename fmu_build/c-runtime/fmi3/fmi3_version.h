/* What an instance of FMI 3.0 has of its own: the importer's logger, and value references by sorts. */
#ifndef FLEXFMU_FMI3_VERSION_H
#define FLEXFMU_FMI3_VERSION_H

#include <stdlib.h>

#include "fmi3Functions.h"
#include "fmi3_states.h"

typedef struct {
  fmi3InstanceEnvironment environment;
  fmi3LogMessageCallback logger;
  fmi3IntermediateUpdateCallback update; /* NULL: not wanted */
  int sets_inputs, reads;                /* what the importer does in it */
} flex_callbacks;

/* The upper bits of a value reference tell what it is, the lower ones which: reals and integers by the backend's own numbers, of an
 * input an array with its derivatives of orders 1, 2, .., arrays with all states and with their derivatives */
enum { FLEX_REAL, FLEX_INTEGER, FLEX_TIME, FLEX_INDICATOR, FLEX_INPUT_DERIVATIVES, FLEX_CLOCK, FLEX_STATES };

#define FLEX_SORT_OF(reference) ((reference) >> 28)
#define FLEX_INDEX_OF(reference) ((reference) & 0x0fffffffu)

/* arrays come with their numbers of elements; what is computed besides outputs */
#define FLEX_COUNT(name) , size_t name
#define FLEX_COUNTED(name, needed) (name)
#define FLEX_IS_COMPUTED(reference) (FLEX_SORT_OF(reference) == FLEX_STATES)

/* instants within a step at which the importer is asked for inputs */
enum { FLEX_ASKED = 4 };

/* what would begin a value reference in a sentence for the logger; whether a sentence is logged whatever the categories */
#define FLEX_ESCAPED '#'
#define FLEX_IS_ALWAYS_LOGGED(status) ((status) >= fmi3Error)

/* categories that are shown whatever the importer asks for */
#define FLEX_IS_SHOWN(category) 0

static inline void flex_hand_over(const flex_callbacks *callbacks, const char *name, fmi3Status status, const char *category,
                                  const char *text) {
  (void)name;
  if (callbacks->logger) callbacks->logger(callbacks->environment, status, category, text);
}

static inline void *flex_allocate(const flex_callbacks *callbacks, size_t size) {
  return (void)callbacks, calloc(1, size);
}

static inline void flex_release(const flex_callbacks *callbacks, void *memory) {
  (void)callbacks;
  free(memory);
}

#endif

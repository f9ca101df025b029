/* What an instance of FMI 2.0 has of its own: the importer's callbacks, which give the memory, too. */
#ifndef FLEXFMU_FMI2_VERSION_H
#define FLEXFMU_FMI2_VERSION_H

#include <stdlib.h>

#include "fmi2Functions.h"
#include "fmi2_states.h"

typedef fmi2CallbackFunctions flex_callbacks;

/* arrays come without their numbers of elements; value references tell nothing of what they are */
#define FLEX_COUNT(name)
#define FLEX_COUNTED(name, needed) (needed)
#define FLEX_IS_COMPUTED(reference) 0

/* what would begin a format in a sentence for the logger; whether a sentence is logged whatever the categories */
#define FLEX_ESCAPED '%'
#define FLEX_IS_ALWAYS_LOGGED(status) 0

/* categories that are shown whatever the importer asks for: what went wrong */
#define FLEX_IS_SHOWN(category) ((category) != LOG_STATISTICS)

static inline void flex_hand_over(const flex_callbacks *callbacks, const char *name, fmi2Status status, const char *category,
                                  const char *text) {
  if (callbacks->logger) callbacks->logger(callbacks->componentEnvironment, name, status, category, text);
}

static inline void *flex_allocate(const flex_callbacks *callbacks, size_t size) {
  return callbacks->allocateMemory ? callbacks->allocateMemory(1, size) : calloc(1, size);
}

static inline void flex_release(const flex_callbacks *callbacks, void *memory) {
  if (callbacks->freeMemory)
    callbacks->freeMemory(memory);
  else
    free(memory);
}

#endif

/* One block of memory for everything: pieces are taken from it in order.
 *
 * The same sequence of calls runs twice: without a block it measures the size, with a block it hands out the pieces. */
#ifndef FLEXFMU_MEMORY_H
#define FLEXFMU_MEMORY_H

#include <stddef.h>

typedef struct {
  char *block; /* NULL while measuring */
  size_t used; /* bytes taken so far */
} flex_arena;

/* takes size bytes, aligned for any type; NULL while measuring */
void *flex_take(flex_arena *arena, size_t size);

double *flex_take_doubles(flex_arena *arena, size_t count);
int *flex_take_ints(flex_arena *arena, size_t count);

#endif

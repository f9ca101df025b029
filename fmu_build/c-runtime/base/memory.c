#include "memory.h"

#include "real.h"

/* bytes; enough for every fundamental type, vector loads of two doubles, and all lanes */
#define ALIGNMENT (sizeof(real) > 16 ? sizeof(real) : (size_t)16)

void *flex_take(flex_arena *arena, size_t size) {
  void *piece = arena->block ? arena->block + arena->used : NULL;
  arena->used += (size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
  return piece;
}

double *flex_take_doubles(flex_arena *arena, size_t count) {
  return flex_take(arena, count * sizeof(double));
}

int *flex_take_ints(flex_arena *arena, size_t count) {
  return flex_take(arena, count * sizeof(int));
}

/* Four doubles side by side in the solver: lanes, one for each stage of a step. Only for lanes_collocation.c. */
#ifndef FLEXFMU_LANES_STAGES_H
#define FLEXFMU_LANES_STAGES_H

#ifdef FLEX_IN_LANES
#include <string.h>

#include "tableaus.h"

typedef double flex_four __attribute__((vector_size(8 * FLEX_MAX_STAGES)));

static inline flex_four flex_load_four(const double *x) {
  flex_four four;
  memcpy(&four, x, sizeof four);
  return four;
}

static inline void flex_store_four(double *target, flex_four x) { memcpy(target, &x, sizeof x); }

/* sum of x_j times column j, for two to four columns; the operations of `flex_combine` in every lane */
static inline flex_four flex_mix_lanes(int count, double (*columns)[FLEX_MAX_STAGES], const double *x) {
  flex_four sum = flex_load_four(columns[0]) * x[0] + flex_load_four(columns[1]) * x[1];
  if (count > 2) sum += flex_load_four(columns[2]) * x[2];
  if (count > 3) sum += flex_load_four(columns[3]) * x[3];
  return sum;
}
#endif

#endif

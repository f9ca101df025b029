/* Variants in lockstep: memory, lanes and one batch from the start to the end. */
#ifndef FLEXFMU_BATCH_RUN_H
#define FLEXFMU_BATCH_RUN_H

#include "batch.h"
#include "plant.h"

typedef struct {
  const flex_batch_task *task;
  flex_plant *plant;
  real *kept;      /* the lanes before variants try a step by themselves */
  real *recording; /* [instants (order + 1) n_recorded] */
  real *motion;    /* position, rate and acceleration [instants 3 n], if derivatives are calculated later */
  int *has_rates;  /* [instants] 1 = the recording has the derivatives */
  real pace;       /* of the motions */
  int *gone;       /* [FLEX_WIDTH] 1 = the lane is a copy of another one */
} flex_batch;

/* pieces of the caller's memory, from its first aligned byte on */
flex_batch flex_batch_create(const flex_batch_task *task, void *memory);

/* number of recorded instants */
int flex_batch_instants(const flex_batch_task *task);

/* simulates up to FLEX_WIDTH variants; lanes without one repeat the last. failed [count] */
void flex_batch_run(flex_batch *whole, int count, const double *values, int *failed);

/* the recording of an instant [(order + 1) n_recorded], and its derivatives, from the motion that is over, with the inputs of the
 * step that begins at a communication point */
real *flex_batch_at(const flex_batch *whole, int instant);
void flex_batch_add_rates(flex_batch *whole, int instant, int step, double time);

/* pace of the lanes in the step that begins at a communication point */
real flex_batch_pace(const flex_batch *whole, int point);

#endif

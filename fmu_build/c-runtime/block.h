/* A discrete-time block in time: it samples at its instants and holds its outputs in between.
 *
 * A sample is due while the present time is its instant. It is taken when somebody asks for the outputs, and again after
 * the inputs have changed; it is completed, with the inputs as they are then, when time goes on. So at a communication
 * point that is an instant the outputs follow the inputs directly, and only the last word counts.
 *
 * All numeric state lies in one piece of memory without pointers, so that saving and restoring it is a copy. */
#ifndef FLEXFMU_BLOCK_H
#define FLEXFMU_BLOCK_H

#include "block_model.h"
#include "inputs.h"
#include "refusal.h"

/* the scalars of the numeric state */
typedef struct {
  double time, start_time; /* [s] */
  long long next;          /* index of the first sample that is not completed; all before it are */
  int is_moving;           /* 1 = initialisation is over */
  int is_due;              /* 1 = the present time is the instant of that sample */
  int is_taken;            /* 1 = y and next_x are those of that sample, for the present inputs and parameters */
} flex_block_record;

typedef struct {
  const flex_block_model *model;
  flex_block_record *record;
  size_t state_size; /* bytes of the numeric state, which begins with the record */

  /* numeric state */
  double *p, *x, *next_x, *y;
  flex_inputs inputs;

  /* scratch */
  double *u, *w;
  int *iw;
  const double **arg;
  double **res;

  char message[FLEX_MESSAGE_SIZE]; /* why the last call was refused */
} flex_block;

/* bytes of memory that an instance needs, zeroed by the caller before flex_block_create */
size_t flex_block_size(const flex_block_model *model);
flex_block *flex_block_create(const flex_block_model *model, void *memory);

/* back to the start values of everything */
void flex_block_reset(flex_block *block);
void flex_block_set_start_time(flex_block *block, double time);

/* an input or parameter has changed */
void flex_block_changed(flex_block *block);

/* all below: 0, or 1 with a sentence in `message` */

/* ends initialisation */
int flex_block_begin(flex_block *block);

/* from t0 to t1, inputs as their polynomials say; after a failure the block stands at the sample that failed */
int flex_block_advance(flex_block *block, double t0, double t1);

/* makes y valid: before the first instant that of the start states, else that of the last instant up to now */
int flex_block_need_outputs(flex_block *block);

#endif

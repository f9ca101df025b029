/* A discrete-time block in time: it samples at its instants and holds its outputs in between.
 *
 * A sample is due while the present time is its instant. It is completed, with the inputs as they are then, when time goes
 * on. Until then its outputs come from the next states, and where they depend on inputs, they need the inputs of this
 * instant: they hold the last completed sample until an input is set here, and follow the inputs from then on. Inputs with
 * derivatives are known here already, from their polynomials. Importers that set inputs before they read outputs so get this
 * sample, as often as they ask; those that read first get the sample before, never one of new states and old inputs. Outputs
 * that depend on states alone are those of the due sample at once.
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
  int is_open;             /* 1 = the inputs of the present time are known: one has been set or follows its polynomial */
  int is_taken;            /* 1 = due_y and next_x are those of that sample, for the present inputs and parameters */
} flex_block_record;

typedef struct {
  const flex_block_model *model;
  flex_block_record *record;
  size_t state_size; /* bytes of the numeric state, which begins with the record */

  /* numeric state */
  double *p, *x, *next_x, *due_y;
  double *y; /* outputs of the last completed sample, of the initial inputs before the first */
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

/* a parameter has changed, an input has been set */
void flex_block_changed(flex_block *block);
void flex_block_input_set(flex_block *block);

/* all below: 0, or 1 with a sentence in `message` */

/* ends initialisation */
int flex_block_begin(flex_block *block);

/* the importer says that the present time is a sample's instant, whose inputs are there or set next */
int flex_block_tick(flex_block *block);

/* from t0 to t1, inputs as their polynomials say; after a failure the block stands at the sample that failed */
int flex_block_advance(flex_block *block, double t0, double t1);

/* an output at the present time: before the first instant that of the start states */
int flex_block_output(flex_block *block, int index, double *value);

#endif

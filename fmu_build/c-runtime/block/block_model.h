/* The contract between a generated discrete-time block and the runtime.
 *
 * At its instants t_k = start time + offset + k sample_time a block reads its inputs u, outputs y and updates its states x:
 *
 *     y_k = output(x_k, u_k, p),     x_{k+1} = update(x_k, u_k, p).
 *
 * Nothing here is ever written at run time. */
#ifndef FLEXFMU_BLOCK_MODEL_H
#define FLEXFMU_BLOCK_MODEL_H

#include "model.h"

typedef struct {
  const char *name;
  const char *guid;

  int n_inputs, n_parameters, n_outputs, n_states;
  int max_input_order; /* highest order that fmi2SetRealInputDerivatives accepts */

  const flex_variable *input_variables, *parameter_variables, *output_variables;
  const int *feeds_through; /* for each output: 1 = it depends on inputs of the same instant */
  const double *start_states;

  double sample_time; /* [s], above zero */
  double offset;      /* first instant after the start [s], zero or positive */

  flex_function sample; /* (x, u, p) -> (y, next x) */
} flex_block_model;

/* the one block of this binary, defined by the generated file */
FLEX_PRIVATE const flex_block_model flex_the_block;

#endif

/* A discrete-time block behind FMI 3.0. */
#include <stddef.h>

#include "block.h"
#include "fmi3_backend.h"
#include "fmi3_input_derivative.h"
#include "fmi3_no_exchange.h"

int flex_backend_max_input_order(void) {
  return flex_the_block.max_input_order;
}

double flex_backend_input_derivative(const flex_backend *backend, unsigned input, int order) {
  // the block is where its message is
  const flex_block *block = (const flex_block *)(const void *)(backend->message - offsetof(flex_block, message));
  return flex_input_derivative(&block->inputs, input, block->record->time, order);
}

/* A plant behind FMI 3.0. */
#include <stddef.h>

#include "fmi3_backend.h"
#include "fmi3_input_derivative.h"
#include "plant.h"

int flex_backend_max_input_order(void) {
  return flex_the_model.max_input_order;
}

double flex_backend_input_derivative(const flex_backend *backend, unsigned input, int order) {
  // the plant is where its message is
  const flex_plant *plant = (const flex_plant *)(const void *)(backend->message - offsetof(flex_plant, message));
  return flex_input_derivative(&plant->inputs, input, plant->record->time, order);
}

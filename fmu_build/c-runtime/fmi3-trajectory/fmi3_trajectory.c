/* A trajectory behind FMI 3.0: it has no inputs. */
#include "fmi3_backend.h"
#include "fmi3_no_exchange.h"

int flex_backend_max_input_order(void) {
  return 0;
}

double flex_backend_input_derivative(const flex_backend *backend, unsigned input, int order) {
  return (void)backend, (void)input, (void)order, 0.0;
}

/* What FMI 3.0 asks of the thing inside the FMU, beyond backend.h and model_exchange.h. Each kind has a file fmi3_<kind>.c with these
 * functions; kinds without continuous states have those of model_exchange.h there too, see fmi3_no_exchange.h. */
#ifndef FLEXFMU_FMI3_BACKEND_H
#define FLEXFMU_FMI3_BACKEND_H

#include "backend.h"

/* highest order of input derivatives; 0 = there are none */
int flex_backend_max_input_order(void);

/* the derivative of an input at the present time; order 1 and above */
double flex_backend_input_derivative(const flex_backend *backend, unsigned input, int order);

#endif

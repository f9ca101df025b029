/* The derivative of an input that is a polynomial, as flex_backend_input_derivative gives it. */
#ifndef FLEXFMU_FMI3_INPUT_DERIVATIVE_H
#define FLEXFMU_FMI3_INPUT_DERIVATIVE_H

#include "inputs.h"

static inline double flex_input_derivative(const flex_inputs *inputs, unsigned input, double time, int order) {
  const double *c = inputs->coefficients + (int)input * (inputs->order + 1);
  double tau = time - inputs->base[input], value = 0.0;
  for (int k = inputs->degree[input]; k >= order; k--)
    value = value * tau + c[k] * (flex_factorial(k) / flex_factorial(k - order));
  return value;
}

#endif

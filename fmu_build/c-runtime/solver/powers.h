/* Powers with whole exponents: products cost a tenth of the general function. And roots. */
#ifndef FLEXFMU_POWERS_H
#define FLEXFMU_POWERS_H

#include <math.h>

#include "elementary.h"

/* x^exponent for exponent >= 0 */
static inline double flex_whole_power(double x, int exponent) {
  double power = 1.0;
  for (int i = 0; i < exponent; i++) power *= x;
  return power;
}

/* the root of x >= 0; the fourth one, of methods with three stages, takes a tenth of the general function's time */
static inline double flex_root(double x, int order) { return order == 4 ? sqrt(sqrt(x)) : pow(x, 1.0 / order); }

#endif

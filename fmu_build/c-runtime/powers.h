/* Powers with whole exponents: products cost a tenth of the general function. */
#ifndef FLEXFMU_POWERS_H
#define FLEXFMU_POWERS_H

/* x^exponent for exponent >= 0 */
static inline double flex_whole_power(double x, int exponent) {
  double power = 1.0;
  for (int i = 0; i < exponent; i++) power *= x;
  return power;
}

#endif

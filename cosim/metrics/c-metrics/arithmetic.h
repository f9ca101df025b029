/* What all parts of the analysis need: norms, powers, and where the terms of a segment are. */
#ifndef FLEXFMU_METRICS_ARITHMETIC_H
#define FLEXFMU_METRICS_ARITHMETIC_H

#include "metrics.h"

#include <math.h>

static inline double dot(const double *first, const double *second, size_t count) {
  double sum = 0.0;
  for (size_t i = 0; i < count; i++) sum += first[i] * second[i];
  return sum;
}

static inline double power(double base, size_t exponent) {
  double result = 1.0;
  for (size_t i = 0; i < exponent; i++) result *= base;
  return result;
}

static inline double norm(const double *vector, size_t count) {
  return count == 1 ? fabs(vector[0]) : sqrt(dot(vector, vector, count));
}

static inline double larger(double first, double second) { return first > second ? first : second; }

static inline double factorial(size_t n) {
  double result = 1.0;
  for (size_t i = 2; i <= n; i++) result *= (double)i;
  return result;
}

static inline const double *terms_of(const metrics_signal *s, size_t i) {
  return s->terms + i * 2 * s->orders * s->channels;
}

#endif

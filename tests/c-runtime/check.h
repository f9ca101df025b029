/* Checks that stop a test with the place and the numbers. */
#ifndef FLEXFMU_CHECK_H
#define FLEXFMU_CHECK_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static const char *doing = "testing"; /* what is being done, for the sentence */

#define CHECK(condition)                                                          \
  do {                                                                            \
    if (!(condition)) {                                                           \
      printf("%s:%d: %s: not true: %s\n", __FILE__, __LINE__, doing, #condition); \
      exit(1);                                                                    \
    }                                                                             \
  } while (0)

#define CHECK_CLOSE(value, expected, tolerance)                                                                             \
  do {                                                                                                                      \
    double value_ = (value), expected_ = (expected), tolerance_ = (tolerance);                                              \
    if (!(fabs(value_ - expected_) <= tolerance_)) {                                                                        \
      printf("%s:%d: %s = %.17g differs from %.17g by %.3g, allowed %.3g\n", __FILE__, __LINE__, #value, value_, expected_, \
             value_ - expected_, tolerance_);                                                                               \
      exit(1);                                                                                                              \
    }                                                                                                                       \
  } while (0)

#define CHECK_BETWEEN(value, low, high)                                                                                   \
  do {                                                                                                                    \
    double value_ = (value);                                                                                              \
    if (!(value_ >= (low) && value_ <= (high))) {                                                                         \
      printf("%s:%d: %s = %.6g is not in %g .. %g\n", __FILE__, __LINE__, #value, value_, (double)(low), (double)(high)); \
      exit(1);                                                                                                            \
    }                                                                                                                     \
  } while (0)

#endif

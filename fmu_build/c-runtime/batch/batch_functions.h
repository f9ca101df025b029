/* Elementary functions of generated code in lanes, in place of those for one number; included before all of it. */
#ifndef FLEXFMU_BATCH_FUNCTIONS_H
#define FLEXFMU_BATCH_FUNCTIONS_H

#include "real.h"

#if FLEX_WIDTH > 1
#include "lanes_math.h"

static inline real flex_each(double (*function)(double), real x) {
  for (int k = 0; k < FLEX_WIDTH; k++) x[k] = function(x[k]);
  return x;
}

static inline real flex_each_two(double (*function)(double, double), real x, real y) {
  for (int k = 0; k < FLEX_WIDTH; k++) x[k] = function(x[k], y[k]);
  return x;
}

#undef sin
#undef cos
#undef tan
#undef asin
#undef acos
#undef atan
#undef atan2
#undef exp
#undef expm1
#undef sinh
#undef cosh
#undef tanh
#undef log
#undef log1p
#undef pow
#undef hypot
#define sin(x) flex_lanes_sin(x)
#define cos(x) flex_lanes_cos(x)
#define sqrt(x) flex_lanes_sqrt(x)
#define fabs(x) flex_lanes_fabs(x)
#define tan(x) flex_each(elementary_tan, x)
#define asin(x) flex_each(elementary_asin, x)
#define acos(x) flex_each(elementary_acos, x)
#define atan(x) flex_each(elementary_atan, x)
#define atan2(y, x) flex_each_two(elementary_atan2, y, x)
#define exp(x) flex_each(elementary_exp, x)
#define expm1(x) flex_each(elementary_expm1, x)
#define sinh(x) flex_each(elementary_sinh, x)
#define cosh(x) flex_each(elementary_cosh, x)
#define tanh(x) flex_each(elementary_tanh, x)
#define log(x) flex_each(elementary_log, x)
#define log1p(x) flex_each(elementary_log1p, x)
#define pow(x, y) flex_each_two(elementary_pow, x, y)
#define hypot(x, y) flex_each_two(elementary_hypot, x, y)
#endif

#endif

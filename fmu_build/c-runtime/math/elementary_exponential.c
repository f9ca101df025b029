/* exp, expm1, sinh, cosh, tanh, erf: x = (32 k + j) ln 2 / 32 + t, e^x = 2^k 2^(j/32) e^t with a table of 2^(j/32);
   P. T. P. Tang, Table-driven implementation of the exponential function, ACM TOMS 15 (1989). */
#include "elementary_exponential.h"

#include "elementary.h"
#include "elementary_exponential_constants.h"

#define TO_INTEGER 0x1.8p52      /* doubles of this size are integers */
#define OVERFLOW_ABOVE 720.0
#define UNDERFLOW_BELOW -760.0
#define NEGLIGIBLE_BEYOND 45.0   /* e^-x is nothing beside e^x, and e^-x nothing beside 1 */
#define SERIES_BELOW 0x1p-9      /* two or three terms of Taylor's series are enough */
#define ERF_IS_ONE 6.0           /* 1 - erf(6) = 2e-17 */
#define TWO_OVER_ROOT_PI_HI 0x1.20dd750429b6dp+0
#define TWO_OVER_ROOT_PI_LO 0x1.1ae3a914fed80p-56

enum { STEPS = 32 };

flex_pair flex_pair_exp(flex_pair x, int *exponent) {
  double steps = (x.hi * STEPS_PER_LN2 + TO_INTEGER) - TO_INTEGER;
  int whole = (int)steps, j = whole & (STEPS - 1);
  *exponent = (whole - j) / STEPS;
  // t = x - steps ln 2 / 32, |t| <= ln 2 / 64, and e^t - 1
  flex_pair t = flex_exact_sum(x.hi - steps * LN2_STEP_0, x.lo - steps * LN2_STEP_1);
  double rest = t.lo + t.hi * t.hi * exponential_series(t.hi);
  // times 2^(j/32)
  double hi = roots_of_two[j][0], lo = roots_of_two[j][1];
  flex_pair grown = flex_exact_product(hi, t.hi);
  flex_pair sum = flex_fast_sum(hi, grown.hi);
  return flex_fast_sum(sum.hi, sum.lo + (grown.lo + (lo + hi * rest + lo * t.hi)));
}

static double scaled_exp(double x, int more) {
  int exponent;
  if (x != x) return x;
  if (x > OVERFLOW_ABOVE) return HUGE_VAL;
  if (x < UNDERFLOW_BELOW) return 0.0;
  flex_pair value = flex_pair_exp((flex_pair){x, 0.0}, &exponent);
  return elementary_ldexp(value.hi, exponent + more);
}

double elementary_exp(double x) { return scaled_exp(x, 0); }

flex_pair flex_pair_expm1(double x) {
  int exponent;
  if (fabs(x) < SERIES_BELOW) return flex_fast_sum(x, x * x * exponential_series(x));
  flex_pair value = flex_pair_exp((flex_pair){x, 0.0}, &exponent);
  double unit = flex_power_of_two(exponent);
  return flex_pair_sum((flex_pair){unit * value.hi, unit * value.lo}, (flex_pair){-1.0, 0.0});
}

double elementary_expm1(double x) {
  if (x != x || x == 0.0) return x;
  if (x > NEGLIGIBLE_BEYOND) return elementary_exp(x);
  if (x < -NEGLIGIBLE_BEYOND) return -1.0;
  return flex_pair_expm1(x).hi;
}

double elementary_sinh(double x) {
  double size = fabs(x);
  if (size < SERIES_BELOW) return x + x * (x * x) * (1.0 / 6.0 + x * x * (1.0 / 120.0));
  if (!(size < NEGLIGIBLE_BEYOND)) return elementary_copysign(scaled_exp(size, -1), x);
  // with m = e^x - 1: (m + m / (m + 1)) / 2
  flex_pair m = flex_pair_expm1(size);
  flex_pair sum = flex_pair_sum(m, flex_pair_ratio(m, flex_pair_sum(m, (flex_pair){1.0, 0.0})));
  return elementary_copysign(0.5 * sum.hi, x);
}

double elementary_cosh(double x) {
  int exponent;
  double size = fabs(x);
  if (!(size < NEGLIGIBLE_BEYOND)) return scaled_exp(size, -1);
  flex_pair value = flex_pair_exp((flex_pair){size, 0.0}, &exponent);
  double unit = flex_power_of_two(exponent);
  flex_pair grown = {unit * value.hi, unit * value.lo};
  return 0.5 * flex_pair_sum(grown, flex_pair_ratio((flex_pair){1.0, 0.0}, grown)).hi;
}

double elementary_tanh(double x) {
  double size = fabs(x);
  if (x != x || x == 0.0) return x;
  if (size < SERIES_BELOW) return x - x * (x * x) * (1.0 / 3.0 - x * x * (2.0 / 15.0));
  if (size > NEGLIGIBLE_BEYOND) return elementary_copysign(1.0, x);
  // with m = e^2x - 1: m / (m + 2)
  flex_pair m = flex_pair_expm1(2.0 * size);
  return elementary_copysign(flex_pair_ratio(m, flex_pair_sum(m, (flex_pair){2.0, 0.0})).hi, x);
}

/* 2 / sqrt(pi) e^(-x^2) (x + 2 x^3 / 3 + 4 x^5 / 15 + ...): all terms of one sign (Abramowitz and Stegun, 7.1.6) */
static flex_pair positive_erf(double x) {
  int exponent;
  flex_pair square = flex_exact_product(x, x), term = {x, 0.0}, sum = term;
  for (int n = 1; term.hi > 0x1p-64 * sum.hi; n++) {
    term = flex_pair_ratio(flex_pair_product(term, square), (flex_pair){n + 0.5, 0.0});
    sum = flex_pair_sum(sum, term);
  }
  flex_pair bell = flex_pair_exp(flex_negative(square), &exponent);
  flex_pair factor = flex_pair_product(bell, (flex_pair){TWO_OVER_ROOT_PI_HI, TWO_OVER_ROOT_PI_LO});
  flex_pair product = flex_pair_product(factor, sum);
  double unit = flex_power_of_two(exponent);
  return (flex_pair){unit * product.hi, unit * product.lo};
}

double elementary_erf(double x) {
  double size = fabs(x);
  if (x != x) return x;
  if (size > ERF_IS_ONE) return elementary_copysign(1.0, x);
  if (x == 0.0) return x;
  if (size < 0x1p-30) {
    flex_pair line = flex_exact_product(x * 0x1p200, TWO_OVER_ROOT_PI_HI);
    return (line.hi + (line.lo + x * 0x1p200 * TWO_OVER_ROOT_PI_LO)) * 0x1p-200;
  }
  return elementary_copysign(positive_erf(size).hi, x);
}

/* log, log1p, asinh, acosh, atanh: x = 2^k c (1 + r) with c = 1 + j/128 and |r| < 1/180, a table of ln c and a polynomial
   in r; P. T. P. Tang, Table-driven implementation of the logarithm function, ACM TOMS 16 (1990). */
#include "elementary.h"
#include "elementary_exponential.h"
#include "elementary_logarithm_constants.h"

#define NEAREST 128.0
#define ROOT_OF_TWO 0x1.6a09e667f3bcdp+0
#define SMALL 0x1p-960
#define LARGE 0x1p960
#define CUBIC_BELOW 0x1p-26 /* asinh x = x - x^3/6 */

static const flex_pair one = {1.0, 0.0};

/* the number without its last 27 digits, so that its square is exact */
static double cut(double x) { return flex_double(flex_bits(x) >> 27 << 27); }

/* ln(1 + r) - r.hi, r = (x - c) / c, c of 8 bits */
static flex_pair reduced_log(double x, double lo, double c, double *r_hi) {
  double distance = x - c; /* exact */
  double inverse = 1.0 / c, hi = cut(distance * inverse);
  double rest = ((distance - hi * c) + lo) * inverse;
  double r = hi + rest;
  *r_hi = hi;
  return (flex_pair){-0.5 * hi * hi, (rest - rest * (hi + 0.5 * rest)) + r * r * r * logarithm_series(r)};
}

flex_pair flex_pair_log(flex_pair x) {
  // away from the ends of the range
  int k = x.hi < SMALL ? -54 : x.hi > LARGE ? 54 : 0;
  double unit = flex_power_of_two(-k), hi = unit * x.hi, lo = unit * x.lo;
  // 2^-1/2..2^1/2 times a power of two
  int exponent = flex_exponent(hi);
  unit = flex_power_of_two(-exponent);
  if (unit * hi > ROOT_OF_TWO) {
    unit *= 0.5;
    exponent++;
  }
  k += exponent;
  hi *= unit;
  lo *= unit;
  // table and polynomial
  int j = (int)(hi * NEAREST + 0.5) - (int)NEAREST;
  double r;
  flex_pair rest = reduced_log(hi, lo, 1.0 + j / NEAREST, &r);
  const double *entry = logarithms[j - FIRST_LOGARITHM];
  flex_pair sum = flex_fast_sum(k * LN2_HI + entry[0], r), more = flex_exact_sum(sum.hi, rest.hi);
  return flex_fast_sum(more.hi, more.lo + (sum.lo + (rest.lo + (entry[1] + k * LN2_LO))));
}

double elementary_log(double x) {
  if (!(x > 0.0)) return x == 0.0 ? -HUGE_VAL : NAN;
  return x < HUGE_VAL ? flex_pair_log((flex_pair){x, 0.0}).hi : x;
}

double elementary_log1p(double x) {
  if (!(x > -1.0)) return x == -1.0 ? -HUGE_VAL : NAN;
  if (fabs(x) < 0x1p-48) return x - 0.5 * x * x;
  return x < HUGE_VAL ? flex_pair_log(flex_exact_sum(1.0, x)).hi : x;
}

double elementary_asinh(double x) {
  double size = fabs(x);
  if (!(size < HUGE_VAL) || x == 0.0) return x;
  if (size < CUBIC_BELOW) return x - x * (x * x) * (1.0 / 6.0);
  if (size > 0x1p54) return elementary_copysign(flex_pair_sum(flex_pair_log((flex_pair){size, 0.0}), (flex_pair){LN2_HI, LN2_LO}).hi, x);
  flex_pair root = flex_pair_root(flex_pair_sum(flex_exact_product(size, size), one));
  return elementary_copysign(flex_pair_log(flex_pair_sum(root, (flex_pair){size, 0.0})).hi, x);
}

double elementary_acosh(double x) {
  if (!(x >= 1.0)) return NAN;
  if (x == HUGE_VAL) return x;
  if (x > 0x1p54) return flex_pair_sum(flex_pair_log((flex_pair){x, 0.0}), (flex_pair){LN2_HI, LN2_LO}).hi;
  flex_pair square = flex_pair_product(flex_exact_sum(x, -1.0), flex_exact_sum(x, 1.0));
  return flex_pair_log(flex_pair_sum(flex_pair_root(square), (flex_pair){x, 0.0})).hi;
}

double elementary_atanh(double x) {
  double size = fabs(x);
  if (!(size < 1.0)) return size == 1.0 ? elementary_copysign(HUGE_VAL, x) : NAN;
  if (size < CUBIC_BELOW) return x + x * (x * x) * (1.0 / 3.0);
  flex_pair upper = flex_pair_log(flex_exact_sum(1.0, size)), lower = flex_pair_log(flex_exact_sum(1.0, -size));
  return elementary_copysign(0.5 * flex_pair_difference(upper, lower).hi, x);
}

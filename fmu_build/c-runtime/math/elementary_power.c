/* pow and hypot, in twice a double's precision inside. */
#include "elementary.h"
#include "elementary_exponential.h"

#define OVERFLOW_ABOVE 720.0
#define UNDERFLOW_BELOW -760.0
#define HUGE_SIDE 0x1p500
#define TINY_SIDE 0x1p-450

typedef enum { FRACTIONAL, EVEN, ODD } parity;

static parity parity_of(double y) {
  if (elementary_floor(y) != y) return FRACTIONAL;
  return elementary_floor(0.5 * y) == 0.5 * y ? EVEN : ODD;
}

/* |x|^y for a finite |x| > 0 and a finite y */
static double positive_power(double x, double y) {
  int exponent;
  flex_pair l = flex_pair_log((flex_pair){x, 0.0});
  double size = l.hi * y;
  if (size == 0.0) return 1.0;
  if (size > OVERFLOW_ABOVE) return HUGE_VAL;
  if (size < UNDERFLOW_BELOW) return 0.0;
  flex_pair product = flex_exact_product(l.hi, y);
  flex_pair value = flex_pair_exp(flex_fast_sum(product.hi, product.lo + l.lo * y), &exponent);
  return elementary_ldexp(value.hi, exponent);
}

/* |x|^y where x is zero or x or y infinite */
static double extreme_power(double x, double y) {
  if (fabs(y) < HUGE_VAL) return (x == 0.0) == (y < 0.0) ? HUGE_VAL : 0.0;
  if (x == 1.0) return 1.0;
  return (x > 1.0) == (y > 0.0) ? HUGE_VAL : 0.0;
}

double elementary_pow(double x, double y) {
  if (y == 0.0 || x == 1.0) return 1.0;
  if (x != x || y != y) return x + y;
  double size = fabs(x);
  int is_extreme = size == 0.0 || size == HUGE_VAL || fabs(y) == HUGE_VAL;
  double power = is_extreme ? extreme_power(size, y) : positive_power(size, y);
  if (!flex_is_negative(x)) return power;
  parity kind = parity_of(y);
  if (kind == FRACTIONAL && !is_extreme) return NAN;
  return kind == ODD ? -power : power;
}

double elementary_hypot(double x, double y) {
  double a = elementary_fmax(fabs(x), fabs(y)), b = elementary_fmin(fabs(x), fabs(y));
  if (a == HUGE_VAL) return a;
  if (x != x || y != y) return x + y;
  if (b <= 0x1p-60 * a) return a;
  double scale = a > HUGE_SIDE ? 0x1p-600 : b < TINY_SIDE ? 0x1p600 : 1.0;
  flex_pair square = flex_exact_product(scale * a, scale * a), other = flex_exact_product(scale * b, scale * b);
  return flex_pair_root(flex_pair_sum(square, other)).hi / scale;
}

/* sin, cos, tan: the argument is reduced to a quadrant and -pi/4..pi/4 as hi + lo, where minimax polynomials take over. */
#include "elementary_sine.h"

#include "elementary.h"
#include "elementary_sine_constants.h"

#define MOST_QUARTERS 1e6  /* of up to 20 bits, so that their products with parts of pi/2 of 33 bits are exact */
#define TO_INTEGER 0x1.8p52  /* doubles of this size are integers */
#define NEAR_ZERO 0x1p-30  /* three parts of pi/2 leave 2^-99: too much of what is nearer to zero */
#define SINE_IS_LINE 0x1p-27 /* x^3/6 is below half a unit of the last place */

/* quadrant, of which the last two digits count, and rest of an angle; Cody and Waite's method */
static int64_t reduce(double x, flex_pair *rest) {
  if (fabs(x) <= QUARTER_PI) {
    *rest = (flex_pair){x, 0.0};
    return 0;
  }
  double quarters = fabs(x) < MOST_QUARTERS ? (x * TWO_OVER_PI + TO_INTEGER) - TO_INTEGER : 0.0;
  double coarse = x - quarters * HALF_PI_0;
  flex_pair fine = flex_exact_sum(coarse, -quarters * HALF_PI_1);
  if (quarters == 0.0 || fabs(fine.hi) < NEAR_ZERO) return flex_reduce_exactly(x, rest);
  *rest = flex_fast_sum(fine.hi, fine.lo - quarters * HALF_PI_2);
  return (int64_t)quarters;
}

/* the part of sin(hi + lo) beyond hi */
static double sine_beyond(flex_pair x) {
  double z = x.hi * x.hi;
  return x.hi * z * sine_series(z) + x.lo * (1.0 - 0.5 * z);
}

static double sine(flex_pair x) { return x.hi + sine_beyond(x); }

/* cos(hi + lo) as 1 - z/2 and what is missing */
static flex_pair cosine_pair(flex_pair x) {
  flex_pair z = flex_exact_product(x.hi, x.hi);
  flex_pair main = flex_fast_sum(1.0, -0.5 * z.hi);
  double rest = z.hi * z.hi * cosine_series(z.hi) - (x.hi * x.lo + 0.5 * z.lo);
  return flex_fast_sum(main.hi, main.lo + rest);
}

static double cosine(flex_pair x) {
  double z = x.hi * x.hi;
  flex_pair main = flex_fast_sum(1.0, -0.5 * z);
  return main.hi + (main.lo + (z * z * cosine_series(z) - x.hi * x.lo));
}

/* sine of a quadrant's angle; the cosine's is that of the next quadrant */
static double sine_in(int64_t quadrant, flex_pair rest) {
  double size = quadrant & 1 ? cosine(rest) : sine(rest);
  return quadrant & 2 ? -size : size;
}

double elementary_sin(double x) {
  flex_pair rest;
  if (fabs(x) < SINE_IS_LINE) return x;
  if (!(fabs(x) < HUGE_VAL)) return NAN;
  int64_t quadrant = reduce(x, &rest);
  return sine_in(quadrant, rest);
}

double elementary_cos(double x) {
  flex_pair rest;
  if (!(fabs(x) < HUGE_VAL)) return NAN;
  int64_t quadrant = reduce(x, &rest);
  return sine_in(quadrant + 1, rest);
}

double elementary_tan(double x) {
  flex_pair rest;
  if (fabs(x) < SINE_IS_LINE) return x;
  if (!(fabs(x) < HUGE_VAL)) return NAN;
  int64_t quadrant = reduce(x, &rest);
  flex_pair s = flex_fast_sum(rest.hi, sine_beyond(rest)), c = cosine_pair(rest);
  flex_pair ratio = quadrant & 1 ? flex_pair_ratio(flex_negative(c), s) : flex_pair_ratio(s, c);
  return ratio.hi + ratio.lo;
}

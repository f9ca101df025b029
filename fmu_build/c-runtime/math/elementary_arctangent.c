/* atan, atan2, asin, acos: the angle of a direction (x, y) in the first octant is that of the nearest one of slope j/64, from a
   table, plus atan of the slope between the two, whose polynomial is short. */
#include "elementary.h"
#include "elementary_arctangent_constants.h"
#include "elementary_pairs.h"

#define SLOPES 64.0
#define NEGLIGIBLE 0x1p-60 /* slopes whose angle is the slope itself */

static const flex_pair pi = {PI_HI, PI_LO};

/* atan(y / x), 0 <= y <= x */
static flex_pair octant_angle(flex_pair y, flex_pair x) {
  int j = (int)(y.hi / x.hi * SLOPES + 0.5);
  flex_pair slope = {j / SLOPES, 0.0};
  flex_pair across = flex_pair_difference(y, flex_pair_product(slope, x));
  flex_pair along = flex_pair_sum(x, flex_pair_product(slope, y));
  flex_pair t = flex_pair_ratio(across, along);
  double z = t.hi * t.hi;
  flex_pair sum = flex_fast_sum(arctangents[j][0], t.hi);
  return flex_fast_sum(sum.hi, sum.lo + (arctangents[j][1] + t.lo + t.hi * z * arctangent_series(z)));
}

/* angle of a direction in the first quadrant */
static flex_pair quadrant_angle(flex_pair y, flex_pair x) {
  if (y.hi <= x.hi) return octant_angle(y, x);
  return flex_pair_difference(flex_halved(pi), octant_angle(x, y));
}

/* a direction where a side is zero or infinite; both positive */
static double extreme_angle(double y, double x) {
  if (y == x) return y == 0.0 ? 0.0 : 0.25 * PI_HI;
  return y > x ? 0.5 * PI_HI : 0.0;
}

static double first_quadrant(double y, double x, int is_turned) {
  if (y == 0.0 || x == 0.0 || y == HUGE_VAL || x == HUGE_VAL) {
    double angle = extreme_angle(y, x);
    return !is_turned ? angle : angle == 0.0 ? PI_HI : angle == 0.5 * PI_HI ? angle : 3.0 * angle;
  }
  if (y < NEGLIGIBLE * x) return is_turned ? PI_HI : y / x;
  if (x < NEGLIGIBLE * y) return 0.5 * PI_HI;
  double larger = y > x ? y : x;
  double scale = larger > 0x1p400 ? 0x1p-500 : larger < 0x1p-400 ? 0x1p600 : 1.0;
  flex_pair angle = quadrant_angle((flex_pair){scale * y, 0.0}, (flex_pair){scale * x, 0.0});
  return is_turned ? flex_pair_difference(pi, angle).hi : angle.hi;
}

double elementary_atan2(double y, double x) {
  if (x != x || y != y) return x + y;
  return elementary_copysign(first_quadrant(fabs(y), fabs(x), flex_is_negative(x)), y);
}

double elementary_atan(double x) {
  if (x != x) return x;
  return elementary_copysign(first_quadrant(fabs(x), 1.0, 0), x);
}

/* sqrt(1 - x^2), of |x| <= 1 */
static flex_pair other_side(double x) {
  return flex_pair_root(flex_pair_product(flex_exact_sum(1.0, -x), flex_exact_sum(1.0, x)));
}

double elementary_asin(double x) {
  if (!(fabs(x) <= 1.0)) return NAN;
  if (fabs(x) < NEGLIGIBLE) return x;
  return elementary_copysign(quadrant_angle((flex_pair){fabs(x), 0.0}, other_side(x)).hi, x);
}

double elementary_acos(double x) {
  if (!(fabs(x) <= 1.0)) return NAN;
  flex_pair angle = quadrant_angle(other_side(x), (flex_pair){fabs(x), 0.0});
  return flex_is_negative(x) ? flex_pair_difference(pi, angle).hi : angle.hi;
}

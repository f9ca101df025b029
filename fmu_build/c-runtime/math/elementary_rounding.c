/* floor, ceil, fmod, remainder, ldexp: exact by their definition in C; here so that an FMU asks no library for them. */
#include "elementary.h"

#define WHOLE_FROM 0x1p52 /* doubles from here on are integers */
#define SMALLEST_NORMAL 0x1p-1022
#define LARGEST_FACTOR 0x1p1023
#define SMALLEST_FACTOR 0x1p-969 /* 2^-1022 2^53: rounds once, at the end */

double elementary_floor(double x) {
  if (!(fabs(x) < WHOLE_FROM)) return x;
  double whole = (double)(int64_t)x;
  return elementary_copysign(whole > x ? whole - 1.0 : whole, x);
}

double elementary_ceil(double x) { return -elementary_floor(-x); }

double elementary_ldexp(double x, int exponent) {
  for (int i = 0; i < 2 && exponent > 1023; i++, exponent -= 1023) x *= LARGEST_FACTOR;
  for (int i = 0; i < 2 && exponent < -969; i++, exponent += 969) x *= SMALLEST_FACTOR;
  exponent = exponent > 1023 ? 1023 : exponent < -1022 ? -1022 : exponent;
  return x * flex_power_of_two(exponent);
}

/* also of numbers below the normal ones */
static int exponent_of(double x) {
  return x < SMALLEST_NORMAL ? flex_exponent(x * 0x1p54) - 54 : flex_exponent(x);
}

/* x modulo y, both positive and finite: doublings of y are taken away, exactly, the largest first; last digit of x / y */
static double positive_fmod(double x, double y, int *is_odd) {
  *is_odd = 0;
  while (x >= y) {
    double multiple = elementary_ldexp(y, exponent_of(x) - exponent_of(y));
    if (multiple > x) multiple *= 0.5;
    *is_odd = multiple == y;
    x -= multiple;
  }
  return x;
}

static int has_no_rest(double x, double y) { return !(fabs(x) < HUGE_VAL) || y != y || y == 0.0; }

double elementary_fmod(double x, double y) {
  int is_odd;
  if (has_no_rest(x, y)) return NAN;
  return elementary_copysign(positive_fmod(fabs(x), fabs(y), &is_odd), x);
}

double elementary_remainder(double x, double y) {
  int is_odd;
  if (has_no_rest(x, y)) return NAN;
  double rest = positive_fmod(fabs(x), fabs(y), &is_odd), missing = fabs(y) - rest;
  int is_upper = rest > missing || (rest == missing && is_odd);
  return elementary_copysign(1.0, x) * (is_upper ? -missing : rest);
}

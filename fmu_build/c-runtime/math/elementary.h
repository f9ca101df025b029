/* The elementary functions of this library, so that an FMU gives the same bits on every platform: the C libraries of this
   world differ in the last place of theirs, some even from processor to processor. Within one unit of the last place,
   made of IEEE 754's exactly rounded operations alone; special values as in C99's annex F, without flags and errno.
   J.-M. Muller, Elementary Functions, 3rd edition, Birkhäuser 2016; coefficients by generators/elementary_constants.py.

   Included after <math.h>, it puts them in place of the C library's. sqrt and fabs are exact everywhere. */
#ifndef FLEXFMU_ELEMENTARY_H
#define FLEXFMU_ELEMENTARY_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

double elementary_sin(double x);
double elementary_cos(double x);
double elementary_tan(double x);
double elementary_asin(double x);
double elementary_acos(double x);
double elementary_atan(double x);
double elementary_atan2(double y, double x);
double elementary_exp(double x);
double elementary_expm1(double x);
double elementary_sinh(double x);
double elementary_cosh(double x);
double elementary_tanh(double x);
double elementary_erf(double x);
double elementary_log(double x);
double elementary_log1p(double x);
double elementary_asinh(double x);
double elementary_acosh(double x);
double elementary_atanh(double x);
double elementary_pow(double x, double y);
double elementary_hypot(double x, double y);
double elementary_floor(double x);
double elementary_ceil(double x);
double elementary_fmod(double x, double y);
double elementary_remainder(double x, double y);
double elementary_ldexp(double x, int exponent);

/* sign, 11 digits of the exponent, 52 of the fraction */
static inline uint64_t flex_bits(double x) {
  uint64_t bits;
  memcpy(&bits, &x, sizeof bits);
  return bits;
}

static inline double flex_double(uint64_t bits) {
  double x;
  memcpy(&x, &bits, sizeof x);
  return x;
}

static inline int flex_is_negative(double x) { return (int)(flex_bits(x) >> 63); }

static inline double elementary_copysign(double size, double sign) {
  const uint64_t first = (uint64_t)1 << 63;
  return flex_double((flex_bits(size) & ~first) | (flex_bits(sign) & first));
}

/* the exponent e of a normal number: 2^e <= |x| < 2^(e + 1) */
static inline int flex_exponent(double x) { return (int)(flex_bits(x) >> 52 & 2047) - 1023; }

/* 2^e, for -1022 <= e <= 1023 */
static inline double flex_power_of_two(int e) { return flex_double((uint64_t)(e + 1023) << 52); }

/* of two zeros the negative one; a number where the other is none */
static inline double elementary_fmin(double x, double y) {
  if (x == y) return flex_is_negative(x) ? x : y;
  return x < y || y != y ? x : y;
}

static inline double elementary_fmax(double x, double y) {
  if (x == y) return flex_is_negative(x) ? y : x;
  return x > y || y != y ? x : y;
}

#ifndef FLEX_ELEMENTARY_KEEP_NAMES
#undef copysign
#define sin(x) elementary_sin(x)
#define cos(x) elementary_cos(x)
#define tan(x) elementary_tan(x)
#define asin(x) elementary_asin(x)
#define acos(x) elementary_acos(x)
#define atan(x) elementary_atan(x)
#define atan2(y, x) elementary_atan2(y, x)
#define exp(x) elementary_exp(x)
#define expm1(x) elementary_expm1(x)
#define sinh(x) elementary_sinh(x)
#define cosh(x) elementary_cosh(x)
#define tanh(x) elementary_tanh(x)
#define erf(x) elementary_erf(x)
#define log(x) elementary_log(x)
#define log1p(x) elementary_log1p(x)
#define asinh(x) elementary_asinh(x)
#define acosh(x) elementary_acosh(x)
#define atanh(x) elementary_atanh(x)
#define pow(x, y) elementary_pow(x, y)
#define hypot(x, y) elementary_hypot(x, y)
#define floor(x) elementary_floor(x)
#define ceil(x) elementary_ceil(x)
#define fmod(x, y) elementary_fmod(x, y)
#define remainder(x, y) elementary_remainder(x, y)
#define ldexp(x, exponent) elementary_ldexp(x, exponent)
#define copysign(size, sign) elementary_copysign(size, sign)
#define fmin(x, y) elementary_fmin(x, y)
#define fmax(x, y) elementary_fmax(x, y)
#endif

/* a part of a long generated function, which stays by itself: compilers take more than in proportion to length */
#ifdef __GNUC__
#define FLEX_APART __attribute__((noinline))
#else
#define FLEX_APART
#endif

#endif

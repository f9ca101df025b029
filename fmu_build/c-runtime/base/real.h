/* The solver's type of number, `real`: a double, or with FLEX_WIDTH > 1 a vector with one double, a lane, for each of so many
 * variants that are simulated in lockstep (GCC's and Clang's vector extensions).
 *
 * Time and step size are common to all lanes, but for a pace: a lane's own time may pass faster or slower. Decisions are made by the worst lane: norms are the largest of all lanes in
 * units of the lane's own motion, conditions hold if they hold in every lane. With one lane nothing is left of all this. */
#ifndef FLEXFMU_REAL_H
#define FLEXFMU_REAL_H

#include <math.h>
#include <string.h>

#include "elementary.h"
#include "memory.h"

#ifndef FLEX_WIDTH
#define FLEX_WIDTH 1
#endif

#if FLEX_WIDTH == 1
typedef double real;

/* the same number in every lane */
static inline real flex_real(double x) { return x; }

/* a lane */
static inline double flex_lane(real x, int lane) {
  (void)lane;
  return x;
}
static inline void flex_set_lane(real *x, int lane, double value) {
  (void)lane;
  *x = value;
}

/* functions of each lane */
static inline real flex_sqrt(real x) { return sqrt(x); }
static inline real flex_fabs(real x) { return fabs(x); }
static inline real flex_larger(real x, real y) { return fmax(x, y); }
static inline real flex_hypot(real x, real y) { return hypot(x, y); }

/* a where the condition x > 0 holds, b elsewhere */
static inline real flex_if_positive(real x, real a, real b) { return x > 0.0 ? a : b; }

/* whether all lanes are finite; are positive; are zero or positive */
static inline int flex_is_finite(real x) { return isfinite(x); }
static inline int flex_is_positive(real x) { return x > 0.0; }
static inline int flex_is_zero_or_more(real x) { return x >= 0.0; }

/* whether any lane is zero */
static inline int flex_has_zero(real x) { return x == 0.0; }

/* the least lane; no number if any lane is none */
static inline double flex_least(real x) { return x; }

/* the least lane of x times its unit; x itself if there is one lane */
static inline double flex_least_of(real x, real unit) {
  (void)unit;
  return x;
}

/* a norm of the worst lane, and the size of the motion, which is one in units of itself */
static inline double flex_worst(real norm, real scale) {
  (void)scale;
  return norm;
}
static inline double flex_common(real scale) { return scale; }

/* a span of the common time in the lane's own, which passes `pace` times as fast; a rate in the common time in the lane's */
static inline real flex_paced(double span, real pace) {
  (void)pace;
  return span;
}
static inline real flex_own_rate(real rate, real pace) {
  (void)pace;
  return rate;
}
#else
typedef double real __attribute__((vector_size(8 * FLEX_WIDTH)));
typedef int64_t flex_real_bits __attribute__((vector_size(8 * FLEX_WIDTH)));

static inline real flex_real(double x) { return x - (real){0.0}; }

static inline double flex_lane(real x, int lane) { return x[lane]; }
static inline void flex_set_lane(real *x, int lane, double value) { (*x)[lane] = value; }

static inline real flex_choose_real(flex_real_bits where, real a, real b) {
  return (real)((where & (flex_real_bits)a) | (~where & (flex_real_bits)b));
}

static inline real flex_sqrt(real x) {
  for (int k = 0; k < FLEX_WIDTH; k++) x[k] = sqrt(x[k]);
  return x;
}

static inline real flex_hypot(real x, real y) {
  for (int k = 0; k < FLEX_WIDTH; k++) x[k] = hypot(x[k], y[k]);
  return x;
}

static inline real flex_fabs(real x) { return (real)((flex_real_bits)x & INT64_MAX); }

/* x where either is no number: it stays seen */
static inline real flex_larger(real x, real y) { return flex_choose_real(y > x, y, x); }

static inline real flex_if_positive(real x, real a, real b) { return flex_choose_real(x > 0.0, a, b); }

static inline int flex_in_all(flex_real_bits condition) {
  int64_t all = -1;
  for (int k = 0; k < FLEX_WIDTH; k++) all &= condition[k];
  return all != 0;
}

static inline int flex_is_finite(real x) { return flex_in_all(x - x == 0.0); }
static inline int flex_is_positive(real x) { return flex_in_all(x > 0.0); }
static inline int flex_is_zero_or_more(real x) { return flex_in_all(x >= 0.0); }
static inline int flex_has_zero(real x) { return !flex_in_all(x != 0.0); }

static inline double flex_least(real x) {
  double least = x[0], rest = 0.0;
  for (int k = 0; k < FLEX_WIDTH; k++) {
    least = x[k] < least ? x[k] : least;
    rest += x[k] - x[k];
  }
  return least + rest;
}

static inline double flex_least_of(real x, real unit) { return flex_least(x * unit); }

static inline double flex_worst(real norm, real scale) { return -flex_least(-norm / scale); }

static inline double flex_common(real scale) {
  (void)scale;
  return 1.0;
}

static inline real flex_paced(double span, real pace) { return span * pace; }
static inline real flex_own_rate(real rate, real pace) { return rate / pace; }
#endif

static inline real *flex_take_reals(flex_arena *arena, size_t count) { return flex_take(arena, count * sizeof(real)); }

/* whether all numbers are finite in all lanes */
static inline int flex_all_finite(const real *x, int count) {
  real sums[4] = {flex_real(0.0), flex_real(0.0), flex_real(0.0), flex_real(0.0)};
  int i = 0;
  for (; i + 4 <= count; i += 4)
    for (int k = 0; k < 4; k++) sums[k] += x[i + k] - x[i + k];
  for (; i < count; i++) sums[0] += x[i] - x[i];
  return flex_is_finite((sums[0] + sums[1]) + (sums[2] + sums[3]));
}

#endif

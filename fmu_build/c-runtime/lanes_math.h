/* Arithmetic on lanes, for generated code.
 *
 * Sine and cosine go through the operations of elementary_sine.c in the same order, for angles that its fast reduction serves; if one
 * lane holds another angle, all go through the scalar function. */
#ifndef FLEXFMU_LANES_MATH_H
#define FLEXFMU_LANES_MATH_H

#include "lanes.h"

#if defined(FLEX_WIDTH) && FLEX_WIDTH > 1
#define FLEX_LANE_COUNT FLEX_WIDTH
#elif defined(FLEX_LANES)
#define FLEX_LANE_COUNT FLEX_LANES
#endif

#ifdef FLEX_LANE_COUNT
#include <stdint.h>
#include <string.h>

#include "elementary.h"
#include "elementary_pairs.h"
#include "elementary_sine_constants.h"

#if defined(FLEX_WIDTH) && FLEX_WIDTH > 1
#define FLEX_WIDE
#define FLEX_WIDE_INLINE static inline __attribute__((always_inline))
#else
#define FLEX_WIDE __attribute__((target("avx2")))
#define FLEX_WIDE_INLINE static inline __attribute__((target("avx2"), always_inline))
#endif

typedef double flex_lanes __attribute__((vector_size(8 * FLEX_LANE_COUNT)));
typedef int64_t flex_lane_bits __attribute__((vector_size(8 * FLEX_LANE_COUNT)));

FLEX_WIDE_INLINE flex_lanes flex_all(double x) { return x - (flex_lanes){0.0}; }

FLEX_WIDE_INLINE flex_lanes flex_load(const double *x) {
  flex_lanes lanes;
  memcpy(&lanes, x, sizeof lanes);
  return lanes;
}

FLEX_WIDE_INLINE void flex_store(double *target, flex_lanes x) { memcpy(target, &x, sizeof x); }

FLEX_WIDE_INLINE flex_lanes flex_lanes_sq(flex_lanes x) { return x * x; }

FLEX_WIDE_INLINE flex_lanes flex_lanes_sqrt(flex_lanes x) {
  for (int k = 0; k < FLEX_LANE_COUNT; k++) x[k] = sqrt(x[k]);
  return x;
}

FLEX_WIDE_INLINE flex_lanes flex_lanes_fabs(flex_lanes x) { return (flex_lanes)((flex_lane_bits)x & INT64_MAX); }

/* a where all bits of a lane are set, b where none is */
FLEX_WIDE_INLINE flex_lanes flex_choose(flex_lane_bits where, flex_lanes a, flex_lanes b) {
  return (flex_lanes)((where & (flex_lane_bits)a) | (~where & (flex_lane_bits)b));
}

typedef struct {
  flex_lanes hi, lo;
  flex_lane_bits quadrant;
  int is_slow; /* not an angle of the fast reduction */
} flex_angles;

/* quadrants and rests of angles; Cody and Waite's method */
FLEX_WIDE_INLINE flex_angles flex_reduce_lanes(flex_lanes x) {
  const flex_lanes to_integer = flex_all(0x1.8p52), size = flex_lanes_fabs(x);
  flex_lanes shifted = x * flex_all(TWO_OVER_PI) + to_integer, quarters = shifted - to_integer;

  // exact sum of the coarse rest and the next part of pi/2
  flex_lanes coarse = x - quarters * flex_all(HALF_PI_0), next = -quarters * flex_all(HALF_PI_1);
  flex_lanes hi = coarse + next, back = hi - coarse;
  flex_lanes lo = (coarse - (hi - back)) + (next - back);

  // fast sum with the last part; angles of the first quadrant stay as they are
  flex_lanes last = lo - quarters * flex_all(HALF_PI_2), sum = hi + last;
  flex_lane_bits is_first = size <= flex_all(QUARTER_PI);
  flex_angles angles;
  angles.hi = flex_choose(is_first, x, sum);
  angles.lo = flex_choose(is_first, flex_all(0.0), last - (sum - hi));
  angles.quadrant = ~is_first & (flex_lane_bits)shifted;

  // tiny, huge and no numbers, and rests next to zero
  flex_lane_bits is_usual = (size >= flex_all(0x1p-27)) & (size < flex_all(1e6));
  flex_lane_bits is_far = (flex_lanes_fabs(hi) >= flex_all(0x1p-30)) & (quarters != flex_all(0.0));
  flex_lane_bits is_fast = is_usual & (is_first | is_far);
  int64_t all_fast = -1;
  for (int k = 0; k < FLEX_LANE_COUNT; k++) all_fast &= is_fast[k];
  angles.is_slow = !all_fast;
  return angles;
}

/* sines of the angles' quadrants and rests, `turned` by a quarter for cosines */
FLEX_WIDE_INLINE flex_lanes flex_sine_lanes(flex_angles x, int turned) {
  const flex_lanes one = flex_all(1.0), half = flex_all(0.5);
  flex_lanes z = x.hi * x.hi, z2 = z * z;

  // sine of the rest
  flex_lanes sine = x.hi + (x.hi * z * SINE_SERIES(z, z2) + x.lo * (one - half * z));

  // cosine of the rest: a fast sum of 1 and -z/2, and what is missing
  flex_lanes drop = -half * z, sum = one + drop, lost = drop - (sum - one);
  flex_lanes cosine = sum + (lost + (z * z * COSINE_SERIES(z, z2) - x.hi * x.lo));

  // which of them, with which sign
  flex_lane_bits quadrant = x.quadrant + turned;
  flex_lanes value = flex_choose(-(quadrant & 1), cosine, sine);
  return (flex_lanes)((flex_lane_bits)value ^ (quadrant & 2) << 62);
}

FLEX_WIDE_INLINE flex_lanes flex_lanes_sin(flex_lanes x) {
  flex_angles angles = flex_reduce_lanes(x);
  if (!angles.is_slow) return flex_sine_lanes(angles, 0);
  for (int k = 0; k < FLEX_LANE_COUNT; k++) x[k] = elementary_sin(x[k]);
  return x;
}

FLEX_WIDE_INLINE flex_lanes flex_lanes_cos(flex_lanes x) {
  flex_angles angles = flex_reduce_lanes(x);
  if (!angles.is_slow) return flex_sine_lanes(angles, 1);
  for (int k = 0; k < FLEX_LANE_COUNT; k++) x[k] = elementary_cos(x[k]);
  return x;
}

#endif
#endif

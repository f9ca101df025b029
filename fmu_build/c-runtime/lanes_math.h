/* Arithmetic on lanes, for generated code: what it calls has these names.
 *
 * Sine and cosine are those of elementary_sine.c for angles that its fast reduction serves, in the same order of operations; if one lane
 * holds another angle, all go through the scalar function. */
#ifndef FLEXFMU_LANES_MATH_H
#define FLEXFMU_LANES_MATH_H

#include "lanes.h"

#ifdef FLEX_LANES
#include <immintrin.h>
#include <stdint.h>

#include "elementary.h"
#include "elementary_pairs.h"
#include "elementary_sine_constants.h"

#define FLEX_WIDE __attribute__((target("avx2")))
#define FLEX_WIDE_INLINE static inline __attribute__((target("avx2"), always_inline))

typedef __m256d flex_lanes;

FLEX_WIDE_INLINE flex_lanes flex_all(double x) { return _mm256_set1_pd(x); }
FLEX_WIDE_INLINE flex_lanes flex_load(const double *x) { return _mm256_loadu_pd(x); }
FLEX_WIDE_INLINE void flex_store(double *target, flex_lanes x) { _mm256_storeu_pd(target, x); }
FLEX_WIDE_INLINE flex_lanes flex_lanes_sq(flex_lanes x) { return x * x; }
FLEX_WIDE_INLINE flex_lanes flex_lanes_sqrt(flex_lanes x) { return _mm256_sqrt_pd(x); }

FLEX_WIDE_INLINE flex_lanes flex_lanes_fabs(flex_lanes x) {
  return _mm256_andnot_pd(flex_all(-0.0), x);
}

typedef struct {
  flex_lanes hi, lo;
  __m256i quadrant;
  int is_slow; /* not an angle of the fast reduction */
} flex_angles;

/* quadrants and rests of angles; Cody and Waite's method as in elementary_sine.c */
FLEX_WIDE_INLINE flex_angles flex_reduce_lanes(flex_lanes x) {
  const flex_lanes to_integer = flex_all(0x1.8p52), size = flex_lanes_fabs(x);
  flex_lanes shifted = x * flex_all(TWO_OVER_PI) + to_integer, quarters = shifted - to_integer;

  // exact sum of the coarse rest and the next part of pi/2
  flex_lanes coarse = x - quarters * flex_all(HALF_PI_0), next = -quarters * flex_all(HALF_PI_1);
  flex_lanes hi = coarse + next, back = hi - coarse;
  flex_lanes lo = (coarse - (hi - back)) + (next - back);

  // a fast sum with the last part
  flex_lanes last = lo - quarters * flex_all(HALF_PI_2), sum = hi + last;
  flex_lanes in_quadrant = _mm256_cmp_pd(size, flex_all(QUARTER_PI), _CMP_LE_OQ);
  flex_angles angles;
  angles.hi = _mm256_blendv_pd(sum, x, in_quadrant);
  angles.lo = _mm256_andnot_pd(in_quadrant, last - (sum - hi));
  angles.quadrant = _mm256_andnot_si256(_mm256_castpd_si256(in_quadrant), _mm256_castpd_si256(shifted));

  // tiny, huge and no numbers, and rests next to zero
  flex_lanes is_usual = _mm256_and_pd(_mm256_cmp_pd(size, flex_all(0x1p-27), _CMP_GE_OQ),
                                      _mm256_cmp_pd(size, flex_all(1e6), _CMP_LT_OQ));
  flex_lanes is_far = _mm256_and_pd(_mm256_cmp_pd(flex_lanes_fabs(hi), flex_all(0x1p-30), _CMP_GE_OQ),
                                    _mm256_cmp_pd(quarters, flex_all(0.0), _CMP_NEQ_OQ));
  flex_lanes is_fast = _mm256_and_pd(is_usual, _mm256_or_pd(in_quadrant, is_far));
  angles.is_slow = _mm256_movemask_pd(is_fast) != 15;
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
  __m256i quadrant = _mm256_add_epi64(x.quadrant, _mm256_set1_epi64x(turned));
  flex_lanes is_odd = _mm256_castsi256_pd(_mm256_slli_epi64(quadrant, 63));
  flex_lanes sign = _mm256_and_pd(_mm256_castsi256_pd(_mm256_slli_epi64(quadrant, 62)), flex_all(-0.0));
  return _mm256_xor_pd(_mm256_blendv_pd(sine, cosine, is_odd), sign);
}

FLEX_WIDE_INLINE flex_lanes flex_lanes_sin(flex_lanes x) {
  flex_angles angles = flex_reduce_lanes(x);
  if (__builtin_expect(!angles.is_slow, 1)) return flex_sine_lanes(angles, 0);
  double each[FLEX_LANES];
  flex_store(each, x);
  for (int i = 0; i < FLEX_LANES; i++) each[i] = elementary_sin(each[i]);
  return flex_load(each);
}

FLEX_WIDE_INLINE flex_lanes flex_lanes_cos(flex_lanes x) {
  flex_angles angles = flex_reduce_lanes(x);
  if (__builtin_expect(!angles.is_slow, 1)) return flex_sine_lanes(angles, 1);
  double each[FLEX_LANES];
  flex_store(each, x);
  for (int i = 0; i < FLEX_LANES; i++) each[i] = elementary_cos(each[i]);
  return flex_load(each);
}

#endif
#endif

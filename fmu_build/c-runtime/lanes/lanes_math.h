/* Arithmetic on lanes, for generated code.
 */
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

FLEX_WIDE_INLINE flex_lanes flex_lanes_all(double x) { return x - (flex_lanes){0.0}; }
#define flex_all flex_lanes_all

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

#define FLEX_V flex_lanes
#define FLEX_V_BITS flex_lane_bits
#define FLEX_V_LANES FLEX_LANE_COUNT
#define FLEX_V_INLINE FLEX_WIDE_INLINE
#define FLEX_V_NAME(x) flex_lanes_##x
#include "elementary_sine_lanes.h"

#endif
#endif

/* Two doubles side by side, for generated code: the same operation for two equal parts of a model.
 *
 * Each part gets the bits that it would get alone. Compilers without vector types, FLEX_PLAIN, and variants in lanes do one after
 * the other. */
#ifndef FLEXFMU_TWINS_H
#define FLEXFMU_TWINS_H

#include <stdint.h>

#include "elementary.h"
#include "elementary_pairs.h"
#include "elementary_sine_constants.h"

#if defined(FLEX_WIDTH) && FLEX_WIDTH > 1
#include "real.h"
#define FLEX_TWIN_PART real
#else
#define FLEX_TWIN_PART double
#endif

#if defined(__GNUC__) && !defined(FLEX_PLAIN) && (!defined(FLEX_WIDTH) || FLEX_WIDTH == 1)

typedef double flex_twin __attribute__((vector_size(16)));
typedef int64_t flex_twin_bits __attribute__((vector_size(16)));

#define flex_twin_of(a, b) ((flex_twin){a, b})
#define flex_twin_first(x) ((x)[0])
#define flex_twin_second(x) ((x)[1])
#define flex_twin_add(a, b) ((a) + (b))
#define flex_twin_sub(a, b) ((a) - (b))
#define flex_twin_mul(a, b) ((a) * (b))
#define flex_twin_div(a, b) ((a) / (b))
#define flex_twin_neg(a) (-(a))
#define flex_twin_fabs(a) ((flex_twin)((flex_twin_bits)(a) & INT64_MAX))

static inline flex_twin flex_twin_all(double x) { return flex_twin_of(x, x); }

#define FLEX_V flex_twin
#define FLEX_V_BITS flex_twin_bits
#define FLEX_V_LANES 2
#define FLEX_V_INLINE static inline
#define FLEX_V_NAME(x) flex_twin_##x
#include "elementary_sine_lanes.h"

#else

typedef struct {
  FLEX_TWIN_PART first, second;
} flex_twin;

#define flex_twin_of(a, b) ((flex_twin){a, b})
#define flex_twin_first(x) ((x).first)
#define flex_twin_second(x) ((x).second)

static inline flex_twin flex_twin_add(flex_twin a, flex_twin b) { return flex_twin_of(a.first + b.first, a.second + b.second); }
static inline flex_twin flex_twin_sub(flex_twin a, flex_twin b) { return flex_twin_of(a.first - b.first, a.second - b.second); }
static inline flex_twin flex_twin_mul(flex_twin a, flex_twin b) { return flex_twin_of(a.first * b.first, a.second * b.second); }
static inline flex_twin flex_twin_div(flex_twin a, flex_twin b) { return flex_twin_of(a.first / b.first, a.second / b.second); }
static inline flex_twin flex_twin_neg(flex_twin a) { return flex_twin_of(-a.first, -a.second); }
static inline flex_twin flex_twin_fabs(flex_twin a) { return flex_twin_of(fabs(a.first), fabs(a.second)); }

static inline flex_twin flex_twin_all(FLEX_TWIN_PART x) { return flex_twin_of(x, x); }
static inline flex_twin flex_twin_sin(flex_twin x) { return flex_twin_of(sin(flex_twin_first(x)), sin(flex_twin_second(x))); }
static inline flex_twin flex_twin_cos(flex_twin x) { return flex_twin_of(cos(flex_twin_first(x)), cos(flex_twin_second(x))); }
#endif

static inline flex_twin flex_twin_turned(flex_twin x) { return flex_twin_of(flex_twin_second(x), flex_twin_first(x)); }
static inline flex_twin flex_twin_sqrt(flex_twin x) { return flex_twin_of(sqrt(flex_twin_first(x)), sqrt(flex_twin_second(x))); }

#endif

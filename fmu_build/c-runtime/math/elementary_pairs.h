/* Double-double arithmetic: unevaluated sums hi + lo of twice a double's precision, |lo| at most half a unit of hi's last place.
   M. Joldes, J.-M. Muller, V. Popescu, Tight and rigorous error bounds for basic building blocks of double-word arithmetic,
   ACM TOMS 44 (2017); T. J. Dekker, Numer. Math. 18 (1971). Products that are split must stay below 2^996 and their
   errors above 2^-1022; callers scale. */
#ifndef FLEXFMU_ELEMENTARY_PAIRS_H
#define FLEXFMU_ELEMENTARY_PAIRS_H

#include <math.h>

typedef struct {
  double hi, lo;
} flex_pair;

/* a + b exactly, for |a| >= |b| or a = 0 */
static inline flex_pair flex_fast_sum(double a, double b) {
  double sum = a + b;
  return (flex_pair){sum, b - (sum - a)};
}

/* a + b exactly */
static inline flex_pair flex_exact_sum(double a, double b) {
  double sum = a + b, shifted = sum - a;
  return (flex_pair){sum, (a - (sum - shifted)) + (b - shifted)};
}

/* upper half of a double's digits; the rest is exact too */
static inline double flex_upper_half(double a) {
  double shifted = 134217729.0 * a; /* 2^27 + 1 */
  return shifted - (shifted - a);
}

/* a b exactly */
static inline flex_pair flex_exact_product(double a, double b) {
  double product = a * b, a1 = flex_upper_half(a), b1 = flex_upper_half(b), a2 = a - a1, b2 = b - b1;
  return (flex_pair){product, ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2};
}

static inline flex_pair flex_negative(flex_pair a) { return (flex_pair){-a.hi, -a.lo}; }

static inline flex_pair flex_halved(flex_pair a) { return (flex_pair){0.5 * a.hi, 0.5 * a.lo}; }

static inline flex_pair flex_pair_sum(flex_pair a, flex_pair b) {
  flex_pair s = flex_exact_sum(a.hi, b.hi), t = flex_exact_sum(a.lo, b.lo);
  flex_pair v = flex_fast_sum(s.hi, s.lo + t.hi);
  return flex_fast_sum(v.hi, t.lo + v.lo);
}

static inline flex_pair flex_pair_difference(flex_pair a, flex_pair b) { return flex_pair_sum(a, flex_negative(b)); }

static inline flex_pair flex_pair_product(flex_pair a, flex_pair b) {
  flex_pair p = flex_exact_product(a.hi, b.hi);
  return flex_fast_sum(p.hi, p.lo + (a.hi * b.lo + a.lo * b.hi));
}

/* b.hi must not be zero */
static inline flex_pair flex_pair_ratio(flex_pair a, flex_pair b) {
  double ratio = a.hi / b.hi;
  flex_pair p = flex_exact_product(ratio, b.hi);
  double rest = ((a.hi - p.hi) - p.lo) + (a.lo - ratio * b.lo);
  return flex_fast_sum(ratio, rest / b.hi);
}

/* a >= 0 */
static inline flex_pair flex_pair_root(flex_pair a) {
  if (!(a.hi > 0.0)) return (flex_pair){a.hi, 0.0};
  double root = sqrt(a.hi);
  flex_pair p = flex_exact_product(root, root);
  double rest = ((a.hi - p.hi) - p.lo) + a.lo;
  return flex_fast_sum(root, rest / (2.0 * root));
}

#endif

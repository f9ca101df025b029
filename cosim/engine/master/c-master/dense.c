/* Signals between communication points, see dense.h: sums in one order, the same as in Python. */
#include "dense.h"

#if defined(__GNUC__)
#define INLINED static inline __attribute__((always_inline))
#else
#define INLINED static inline
#endif

/* one derivative of a signal at all instants; wider registers don't change the sums */
INLINED void interpolate(const master_dense *dense, const double *weight, const double *values, const double *first,
                        const double *second, const double *recorded, double *found) {
  for (size_t i = 0; i < dense->count; i++, weight += 12) {
    const long long at = dense->begins[i], point = dense->points[i];
    /* four sums side by side, one for each point */
    double part[4];
    for (int k = 0; k < 4; k++)
      part[k] = weight[k] * values[at + k] + weight[4 + k] * first[at + k] + weight[8 + k] * second[at + k];
    found[i] = point < 0 ? (part[0] + part[1]) + (part[2] + part[3]) : recorded[point];
  }
}

INLINED void interpolate_all(const master_dense *dense, const double *table, size_t distance,
                                   const long long *signals, size_t count, size_t orders, double *found) {
  for (size_t i = 0; i < count; i++, signals += 5) {
    const double *values = table + (size_t)signals[0] * distance, *own = table + (size_t)signals[2] * distance;
    const size_t next = (size_t)signals[1] * distance, own_next = (size_t)signals[3] * distance;
    for (size_t n = 0; n < orders; n++, found += dense->count) {
      const double *weights = dense->weights + 12 * dense->count * ((size_t)signals[4] + n);
      interpolate(dense, weights, values, values + next, values + 2 * next, own + n * own_next, found);
    }
  }
}

#if defined(__x86_64__) && defined(__GNUC__) && !defined(_WIN32)
__attribute__((target("avx2"))) static void interpolate_wide(const master_dense *dense, const double *table,
                                                             size_t distance, const long long *signals, size_t count,
                                                             size_t orders, double *found) {
  interpolate_all(dense, table, distance, signals, count, orders, found);
}
#define WIDE __builtin_cpu_supports("avx2")
#else
#define WIDE 0
#define interpolate_wide interpolate_all
#endif

EXPORTED void master_interpolate(const master_dense *dense, const double *table, size_t distance, const long long *signals,
                                 size_t count, size_t orders, double *found) {
  if (WIDE)
    interpolate_wide(dense, table, distance, signals, count, orders, found);
  else
    interpolate_all(dense, table, distance, signals, count, orders, found);
}

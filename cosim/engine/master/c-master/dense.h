/* Interpolation of recorded signals between communication points: weighted sums of values and derivatives at four of them. */
#ifndef FLEXFMU_DENSE_H
#define FLEXFMU_DENSE_H

#include "master.h"

/* the instants at which signals are wanted */
typedef struct {
  size_t count;
  const long long *begins; /* index of the first of the four points around each instant */
  const long long *points; /* index of the point that the instant is; -1 between points */
  const double *weights;   /* [order][instant][12]: of the values at the four points, of first and of second derivatives */
} master_dense;

/* found[signal][order][instant], order < orders <= 3, from a table whose rows are `distance` apart. For each of `count` signals five
 * numbers: row of the interpolated values, and how many rows further their derivatives are; row and rows of what was recorded itself,
 * for instants that are points; lowest order of the derivatives that are found */
EXPORTED void master_interpolate(const master_dense *dense, const double *table, size_t distance, const long long *signals,
                        size_t count, size_t orders, double *found);

#endif

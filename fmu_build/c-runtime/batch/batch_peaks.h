/* The largest magnitude of a signal between two instants, from values and two derivatives at both. */
#ifndef FLEXFMU_BATCH_PEAKS_H
#define FLEXFMU_BATCH_PEAKS_H

#include "real.h"

/* the larger of `peak` and the largest magnitude of the quintic Hermite polynomial over a segment. begin, end: value, first
 * and second derivative, `stride` apart; step: length of the segment [s] */
real flex_segment_peak(real step, int stride, const real *begin, const real *end, real peak);

#endif

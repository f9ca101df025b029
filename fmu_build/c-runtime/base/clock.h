/* When two times are one. */
#ifndef FLEXFMU_CLOCK_H
#define FLEXFMU_CLOCK_H

#include <float.h>
#include <math.h>

/* how far apart they may be [s]: a part of the step, and roundings of a time that was summed up */
static inline double flex_time_slack(double time, double step) { return 1e-6 * step + 8.0 * DBL_EPSILON * fabs(time); }

#endif

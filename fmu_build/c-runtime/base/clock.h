/* When two times are one. */
#ifndef FLEXFMU_CLOCK_H
#define FLEXFMU_CLOCK_H

/* how far apart they may be [s]: a part of the step, and roundings of a time that was summed up */
double flex_time_slack(double time, double step);

#endif

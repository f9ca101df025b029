#include "clock.h"

#include <float.h>
#include <math.h>

#define SHARE 1e-6
#define ROUNDINGS 8.0

double flex_time_slack(double time, double step) {
  return SHARE * step + ROUNDINGS * DBL_EPSILON * fabs(time);
}

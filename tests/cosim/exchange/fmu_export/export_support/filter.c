#include <math.h>

/* Two low-pass filters whose inputs pass with a sine of the time. */
void filter(double t, const double *u, const double *p, const double *x, double *y, double *next_x) {
  for (int i = 0; i < 2; ++i) {
    y[i] = p[0] * x[i] + p[1] * u[i] * sin(40.0 * t);
    next_x[i] = p[0] * x[i] + (1.0 - p[0]) * u[i];
  }
}

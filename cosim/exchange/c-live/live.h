#ifndef FLEXFMU_LIVE_H
#define FLEXFMU_LIVE_H

#define LIVE_EXPORTED __attribute__((visibility("default")))

/* polynomials [steps][10][variables] of degree 9 between limits [steps + 1][5][variables]: right ones where a step begins, left ones
 * where it ends; scales [steps][10] are powers of its length over factorials */
LIVE_EXPORTED void live_hermite(int steps, int variables, const double *begins, const double *ends, const double *scales, double *found);

#endif

/* What a page's module has beside FMU, blocks and master: Hermite polynomials with the bits that Python's run has. */
#include "live.h"

#include <math.h>

enum { ENDS = 5, TERMS = 10 };

static const double from_known[ENDS][ENDS] = {{1, 1, 1, 1, 1}, {0, 1, 2, 3, 4}, {0, 0, 1, 3, 6}, {0, 0, 0, 1, 4}, {0, 0, 0, 0, 1}};
static const double from_rest[ENDS][ENDS] = {
    {126, -56, 21, -6, 1}, {-420, 196, -77, 23, -4}, {540, -260, 106, -33, 6}, {-315, 155, -65, 21, -4}, {70, -35, 15, -5, 1}};

/* the products of flexfmu.cosim.engine.hermite, which BLAS forms with fused operations, one term after the other */
static double product(const double *row, const double *column) {
  double sum = 0.0;
  for (int k = 0; k < ENDS; k++) sum = fma(row[k], column[k], sum);
  return sum;
}

LIVE_EXPORTED void live_hermite(int steps, int variables, const double *begins, const double *ends, const double *scales, double *found) {
  for (int n = 0; n < steps; n++) {
    const double *left = begins + n * ENDS * variables, *right = ends + (n + 1) * ENDS * variables, *scale = scales + n * TERMS;
    double *out = found + n * TERMS * variables;
    for (int v = 0; v < variables; v++) {
      double known[ENDS], beyond[ENDS];
      for (int k = 0; k < ENDS; k++) {
        out[k * variables + v] = left[k * variables + v];
        known[k] = left[k * variables + v] * scale[k];
      }
      for (int k = 0; k < ENDS; k++) beyond[k] = right[k * variables + v] * scale[k] - product(from_known[k], known);
      for (int k = 0; k < ENDS; k++) out[(ENDS + k) * variables + v] = product(from_rest[k], beyond) / scale[ENDS + k];
    }
  }
}

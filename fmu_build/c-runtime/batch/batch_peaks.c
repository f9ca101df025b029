/* Extrema of quintic polynomials in Bernstein's form: the coefficients bound the polynomial, and halving it sharpens the bound
 * (Farin, Curves and Surfaces for CAGD, 5th edition, chapters 4 to 6). */
#include "batch_peaks.h"

enum { DEGREE = 5 };

/* difference of bound and value, relative to the peak, at which a piece is not halved any more; halvings at most */
#define SHARP 1e-12
#define MOST_HALVINGS 40

// the two halves of a polynomial (de Casteljau's algorithm)
static void halve(const double *whole, double *left, double *right) {
  double row[DEGREE + 1];
  memcpy(row, whole, sizeof row);
  for (int k = 0; k <= DEGREE; k++) {
    left[k] = row[0];
    right[DEGREE - k] = row[DEGREE - k];
    for (int i = 0; i < DEGREE - k; i++) row[i] = 0.5 * (row[i] + row[i + 1]);
  }
}

static double bound(const double *coefficients) {
  double largest = 0.0;
  for (int k = 0; k <= DEGREE; k++) largest = fmax(largest, fabs(coefficients[k]));
  return largest;
}

// the larger of `peak` and the polynomial's largest magnitude; pieces that can't reach the peak are left out
static double sharpened(const double *coefficients, double peak) {
  double pieces[MOST_HALVINGS + 1][DEGREE + 1];
  int depth[MOST_HALVINGS + 1], count = 1;
  memcpy(pieces[0], coefficients, sizeof pieces[0]);
  depth[0] = 0;
  while (count > 0) {
    // values at both ends are reached
    double piece[DEGREE + 1];
    int level = depth[--count];
    memcpy(piece, pieces[count], sizeof piece);
    peak = fmax(peak, fmax(fabs(piece[0]), fabs(piece[DEGREE])));
    if (!(bound(piece) > peak * (1.0 + SHARP)) || level == MOST_HALVINGS) continue;

    // both halves onto the stack, which holds at most one piece of each level and one more
    halve(piece, pieces[count], pieces[count + 1]);
    depth[count] = depth[count + 1] = level + 1;
    count += 2;
  }
  return peak;
}

real flex_segment_peak(real step, int stride, const real *begin, const real *end, real peak) {
  real b[DEGREE + 1];
  real slope0 = (0.2 * step) * begin[stride], slope1 = (0.2 * step) * end[stride];
  real curve0 = (0.05 * step * step) * begin[2 * stride], curve1 = (0.05 * step * step) * end[2 * stride];

  // coefficients of the Hermite polynomial
  b[0] = begin[0];
  b[1] = b[0] + slope0;
  b[2] = b[0] + 2.0 * slope0 + curve0;
  b[5] = end[0];
  b[4] = b[5] - slope1;
  b[3] = b[5] - 2.0 * slope1 + curve1;

  // most segments lie below the peak in all lanes
  real largest = flex_fabs(b[0]);
  for (int k = 1; k <= DEGREE; k++) largest = flex_larger(largest, flex_fabs(b[k]));
  if (flex_is_zero_or_more(peak - largest)) return peak;
  for (int lane = 0; lane < FLEX_WIDTH; lane++) {
    double coefficients[DEGREE + 1];
    if (!(flex_lane(largest, lane) > flex_lane(peak, lane))) continue;
    for (int k = 0; k <= DEGREE; k++) coefficients[k] = flex_lane(b[k], lane);
    flex_set_lane(&peak, lane, sharpened(coefficients, flex_lane(peak, lane)));
  }
  return peak;
}

#include "trajectory.h"

#include <math.h>
#include <string.h>

enum { ENDS = FLEX_END_ORDER + 1, TERMS = 2 * ENDS };

/* Two-point Hermite interpolation in s = 0..1: the normalised coefficients c_0..c_4 are given at s = 0; c_5..c_9 follow
 * from what is missing at s = 1 by the inverse of the matrix C(5 + j, i), which is integer. */
static const double end_matrix[ENDS][ENDS] = {
    {126, -56, 21, -6, 1},
    {-420, 196, -77, 23, -4},
    {540, -260, 106, -33, 6},
    {-315, 155, -65, 21, -4},
    {70, -35, 15, -5, 1},
};

// number of knots before a time, those at the time itself included on request
static int count_knots(const flex_trajectory_model *model, double time, int included) {
  int low = 0, high = model->n_knots;
  while (low < high) {
    int middle = low + (high - low) / 2;
    int is_before = included ? model->times[middle] <= time : model->times[middle] < time;
    if (is_before)
      low = middle + 1;
    else
      high = middle;
  }
  return low;
}

static int is_breakpoint(const flex_trajectory_model *model, int knot) {
  const double *t = model->times;
  if (knot == 0 || knot == model->n_knots - 1) return 1;
  return t[knot] == t[knot - 1] || t[knot] == t[knot + 1];
}

double flex_trajectory_landing(const flex_trajectory_model *model, double time, double slack, flex_limit limit) {
  double landing = time;
  int found = 0;
  for (int i = count_knots(model, time - slack, 0); i < model->n_knots && model->times[i] <= time + slack; i++) {
    if (!is_breakpoint(model, i) || (found && limit == FLEX_LEFT)) continue;
    landing = model->times[i];
    found = 1;
  }
  return landing;
}

double flex_trajectory_next(const flex_trajectory_model *model, double time) {
  for (int i = count_knots(model, time, 1); i < model->n_knots; i++)
    if (is_breakpoint(model, i)) return model->times[i];
  return HUGE_VAL;
}

// coefficients of the polynomial in s between normalised derivatives at s = 0 and s = 1
static void hermite(const double *begin, const double *end, double *c) {
  double missing[ENDS];
  for (int i = 0; i < ENDS; i++) {
    double binomial = 1.0;
    missing[i] = end[i];
    for (int j = i; j < ENDS; j++) {
      missing[i] -= binomial * begin[j];
      binomial = binomial * (j + 1) / (j + 1 - i);
    }
  }
  memcpy(c, begin, ENDS * sizeof *c);
  for (int i = 0; i < ENDS; i++) {
    c[ENDS + i] = 0.0;
    for (int j = 0; j < ENDS; j++) c[ENDS + i] += end_matrix[i][j] * missing[j];
  }
}

// the first coefficients of the same polynomial about another s
static void expand_about(double s, double *c) {
  for (int i = 0; i < ENDS; i++)
    for (int k = TERMS - 2; k >= i; k--) c[k] += s * c[k + 1];
}

// value and derivatives of one signal between two knots, from the nearer one: so they are exact at both
static void interpolate(const double *left, const double *right, int stride, double width, double after, double before,
                        double *result, int result_stride) {
  int is_mirrored = after > before;
  double begin[ENDS], end[ENDS], c[TERMS], scale = 1.0;
  for (int k = 0; k < ENDS; k++) {
    double sign = is_mirrored && k % 2 ? -1.0 : 1.0;
    begin[k] = sign * scale * (is_mirrored ? right : left)[k * stride];
    end[k] = sign * scale * (is_mirrored ? left : right)[k * stride];
    scale *= width / (k + 1);
  }
  hermite(begin, end, c);
  expand_about((is_mirrored ? before : after) / width, c);

  // back to derivatives in time
  scale = 1.0;
  for (int k = 0; k < ENDS; k++) {
    result[k * result_stride] = (is_mirrored && k % 2 ? -1.0 : 1.0) * c[k] / scale;
    scale *= width / (k + 1);
  }
}

// derivatives of the positions and velocities: the velocities and accelerations with theirs
static void complete(int n_axes, double *signals) {
  int n = FLEX_KINDS * n_axes;
  for (int k = 1; k < ENDS; k++) {
    double *row = signals + k * n, *above = signals + (k - 1) * n;
    for (int i = n_axes - 1; i >= 0; i--) {
      row[n_axes + i] = above[2 * n_axes + i];
      row[i] = above[n_axes + i];
    }
  }
}

void flex_trajectory_evaluate(const flex_trajectory_model *model, double time, flex_limit limit, double *signals) {
  int axes = model->n_axes, n = FLEX_KINDS * axes, size = FLEX_KNOT_ORDERS * axes;
  int next = count_knots(model, time, limit == FLEX_RIGHT);
  memset(signals, 0, (size_t)(ENDS * n) * sizeof *signals);

  // standstill at the start or at the end
  if (next == 0 || next == model->n_knots) {
    const double *still = next == 0 ? model->jets : model->jets + (model->n_knots - 1) * size;
    memcpy(signals, still, (size_t)axes * sizeof *signals);
    return;
  }

  // between two knots
  const double *left = model->jets + (next - 1) * size, *right = left + size;
  double begin = model->times[next - 1], end = model->times[next];
  for (int i = 0; i < n; i++)
    interpolate(left + i, right + i, axes, end - begin, time - begin, end - time, signals + i, n);
  complete(axes, signals);
}

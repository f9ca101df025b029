/* Terms, bounds and error estimates of all segments; names and constants are those of flexfmu.cosim.metrics.segments. */
#include "arithmetic.h"

#include <string.h>

#define COMPARABLE_STEPS 0.1
#define CONTINUITY 1e-9
#define DIVERGING 3.0

static const double *left_of(const metrics_signal *s, size_t order, size_t i) {
  return s->left + order * s->left_stride + i * s->channels;
}

static const double *right_of(const metrics_signal *s, size_t order, size_t i) {
  return s->right + order * s->right_stride + i * s->channels;
}

/* the terms of a segment, from the Taylor coefficients at both ends: after its first term is subtracted, a polynomial is
 * divided by theta (1 - theta) */
static void find_terms(const metrics_signal *s, size_t i) {
  const size_t m = s->orders, c = s->channels;
  double *terms = s->terms + i * 2 * m * c, scale = 1.0;
  for (size_t k = 0; k < m; k++) {
    for (size_t j = 0; j < c; j++) {
      terms[k * c + j] = left_of(s, k, i)[j] * scale;
      terms[(m + k) * c + j] = right_of(s, k, i)[j] * (k % 2 ? -scale : scale);
    }
    scale *= s->duration[i] / (double)(k + 1);
  }
  for (size_t j = 0; j < c; j++) {
    double *alpha = terms + j, *beta = terms + m * c + j;
    for (size_t k = 0; k + 1 < m; k++) {
      const double slope = beta[k * c] - alpha[k * c];
      alpha[(k + 1) * c] -= slope;
      beta[(k + 1) * c] += slope;
      for (size_t l = k + 2; l < m; l++) {
        alpha[l * c] += alpha[(l - 1) * c];
        beta[l * c] += beta[(l - 1) * c];
      }
    }
  }
}

/* the largest squared norm of term k at METRICS_SAMPLES times, from |alpha|^2, alpha . beta and |beta|^2 */
static double contribution(size_t k, const double products[3]) {
  double largest = 0.0;
  for (size_t i = 0; i < METRICS_SAMPLES; i++) {
    const double theta = (double)i / (METRICS_SAMPLES - 1), rest = 1.0 - theta;
    const double line = rest * rest * products[0] + 2.0 * theta * rest * products[1] + theta * theta * products[2];
    largest = larger(largest, power(theta * rest, 2 * k) * line);
  }
  return largest;
}

/* bounds of a segment; leaves out the terms from the first order, from the second on, that contributes far more than the
 * one before */
static void find_bounds(const metrics_signal *s, size_t i) {
  const size_t m = s->orders, c = s->channels;
  double *terms = s->terms + i * 2 * m * c, products[METRICS_ORDERS][3], weight = 1.0;
  s->bounds[i] = 0.0;
  for (s->kept[i] = 0; s->kept[i] < m; s->kept[i]++, weight *= 0.25) {
    const size_t k = s->kept[i];
    double *alpha = terms + k * c, *beta = terms + (m + k) * c, *now = products[k];
    now[0] = dot(alpha, alpha, c);
    now[1] = dot(alpha, beta, c);
    now[2] = dot(beta, beta, c);
    if (k >= 2) {
      /* the largest that this order can be, against the one before in the middle, before both are found */
      const double *before = products[k - 1], ratio = DIVERGING * DIVERGING;
      if (larger(now[0], now[2]) > 4.0 * ratio * (before[0] + 2.0 * before[1] + before[2]) &&
          contribution(k, now) > ratio * contribution(k - 1, before)) {
        memset(alpha, 0, (m - k) * c * sizeof(double));
        memset(beta, 0, (m - k) * c * sizeof(double));
        return;
      }
    }
    /* NaN must not get lost: the sum has it */
    const double largest = c == 1 ? larger(fabs(alpha[0]), fabs(beta[0])) : sqrt(larger(now[0], now[2]));
    const double size = largest + 0.0 * (now[0] + now[2]);
    if (k == 0) s->ends[i] = size;
    s->bounds[i] += weight * size;
  }
}

/* all derivatives [orders][channels] at the start (side 0) or the end (side 1) of segment i, of what was kept of it */
static void find_derivatives(const metrics_signal *s, size_t i, size_t side, double *result) {
  const size_t m = s->orders, c = s->channels;
  for (size_t k = 0; k < m; k++)
    for (size_t j = 0; j < c; j++) result[k * c + j] = side ? right_of(s, k, i)[j] : left_of(s, k, i)[j];
  if (s->kept[i] == m) return;
  for (size_t j = 0; j < c; j++) {
    /* the steps of find_terms, backwards */
    double near[METRICS_ORDERS], far[METRICS_ORDERS], scale = 1.0;
    for (size_t k = 0; k < m; k++) {
      near[k] = terms_of(s, i)[(side * m + k) * c + j];
      far[k] = terms_of(s, i)[((1 - side) * m + k) * c + j];
    }
    for (size_t k = m - 1; k-- > 0;) {
      for (size_t l = m - 1; l > k + 1; l--) {
        near[l] -= near[l - 1];
        far[l] -= far[l - 1];
      }
      const double slope = far[k] - near[k];
      near[k + 1] += slope;
      far[k + 1] -= slope;
    }
    for (size_t k = 0; k < m; k++) {
      result[k * c + j] = near[k] / scale;
      scale *= (side ? -s->duration[i] : s->duration[i]) / (double)(k + 1);
    }
  }
}

/* the largest magnitudes [orders] of the derivatives at the inner nodes */
static void find_sizes(const metrics_signal *s, double *sizes) {
  const size_t m = s->orders, c = s->channels;
  double before[METRICS_ORDERS * METRICS_CHANNELS], after[METRICS_ORDERS * METRICS_CHANNELS];
  memset(sizes, 0, m * sizeof(double));
  for (size_t i = 0; i + 1 < s->segments; i++) {
    find_derivatives(s, i, 1, before);
    find_derivatives(s, i + 1, 0, after);
    for (size_t k = 0; k < m; k++)
      sizes[k] = larger(sizes[k], larger(norm(before + k * c, c), norm(after + k * c, c)));
  }
}

/* whether all derivatives are continuous at the end of segment i; sizes are found when they are needed first */
static int is_continuous(const metrics_signal *s, size_t i, double *sizes, int *known) {
  const size_t m = s->orders, c = s->channels;
  double before[METRICS_ORDERS * METRICS_CHANNELS], after[METRICS_ORDERS * METRICS_CHANNELS];
  int same = s->kept[i] == m && s->kept[i + 1] == m;
  for (size_t k = 0; same && k < m; k++)
    for (size_t j = 0; j < c; j++) same = same && right_of(s, k, i)[j] == left_of(s, k, i + 1)[j];
  if (same) return 1;
  find_derivatives(s, i, 1, before);
  find_derivatives(s, i + 1, 0, after);
  for (size_t k = 0; k < m; k++) {
    for (size_t j = 0; j < c; j++) after[k * c + j] -= before[k * c + j];
    const double jump = norm(after + k * c, c);
    if (jump == 0.0) continue;
    if (!*known) find_sizes(s, sizes);
    *known = 1;
    if (!(jump <= CONTINUITY * sizes[k])) return 0;
  }
  return 1;
}

/* channel j of the derivative of order m over theta at the start (side 0) or the end (side 1) of segment i */
static double highest_at(const metrics_signal *s, size_t i, size_t side, size_t j) {
  const size_t m = s->orders, c = s->channels;
  const double *near = terms_of(s, i) + side * m * c + j, *far = terms_of(s, i) + (1 - side) * m * c + j;
  double sum = 0.0;
  /* the degree of the lower terms is below m */
  for (size_t k = (m - 1) / 2; k < m; k++) sum += s->highest[k] * near[k * c] + s->highest[m + k] * far[k * c];
  return side && m % 2 ? -sum : sum;
}

/* the derivative of order 2 m at the nodes where the interpolated ones are continuous, elsewhere NaN */
static void find_jumps(const metrics_signal *s) {
  const size_t m = s->orders, c = s->channels;
  const double factor = factorial(2 * m) / factorial(m);
  double sizes[METRICS_ORDERS], after = s->segments ? power(s->duration[0], m) : 0.0;
  int known = 0;
  for (size_t j = 0; j < c; j++) s->jumps[j] = s->jumps[s->segments * c + j] = NAN;
  for (size_t i = 0; i + 1 < s->segments; i++) {
    const double first = s->duration[i], second = s->duration[i + 1];
    const double before = after;
    after = power(second, m);
    const int comparable = first > COMPARABLE_STEPS * second && second > COMPARABLE_STEPS * first;
    const int useful = comparable && is_continuous(s, i, sizes, &known);
    for (size_t j = 0; j < c; j++) {
      const double jump = highest_at(s, i + 1, 0, j) / after - highest_at(s, i, 1, j) / before;
      s->jumps[(i + 1) * c + j] = useful ? jump * factor / (before + after) : NAN;
    }
  }
}

/* the largest norm of the term of order k in segment i */
static double size_of_term(const metrics_signal *s, size_t i, size_t k) {
  const size_t c = s->channels;
  const double *alpha = terms_of(s, i) + k * c, *beta = terms_of(s, i) + (s->orders + k) * c;
  return sqrt(contribution(k, (const double[]){dot(alpha, alpha, c), dot(alpha, beta, c), dot(beta, beta, c)}));
}

/* from the nodes, or where these are unknown, the last term; and where orders were left out, the last that was kept */
static void find_errors(const metrics_signal *s) {
  const size_t m = s->orders, c = s->channels;
  const double shape = power(0.25, m) / factorial(2 * m);
  for (size_t i = 0; i < s->segments; i++) {
    const double start = norm(s->jumps + i * c, c), end = norm(s->jumps + (i + 1) * c, c);
    const double derivative = isnan(start) || start < end ? end : start, scale = power(s->duration[i], m);
    s->errors[i] = isnan(derivative) ? size_of_term(s, i, m - 1) : derivative * shape * scale * scale;
    if (s->kept[i] < m) s->errors[i] += size_of_term(s, i, s->kept[i] - 1);
  }
}

size_t metrics_prepare(const metrics_signal *s) {
  size_t diverging = 0;
  for (size_t i = 0; i < s->segments; i++) {
    find_terms(s, i);
    find_bounds(s, i);
    diverging += s->kept[i] < s->orders;
  }
  find_jumps(s);
  find_errors(s);
  return diverging;
}

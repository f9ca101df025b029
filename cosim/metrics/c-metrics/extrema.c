/* The largest norm, the last crossing of a level, and positive and negative parts, by bisection of Bernstein polynomials,
 * see flexfmu.cosim.metrics.segments. */
#include "arithmetic.h"

#include <string.h>

#define PEAK_TOLERANCE 1e-11
#define MAXIMUM_BISECTIONS 60
#define ZERO_BISECTIONS 30
#define POINTS (2 * METRICS_ORDERS)

/* control points, with all channels of the first, then of the second, and so on */
typedef struct {
  size_t points, channels;
  double values[POINTS * METRICS_CHANNELS];
} control;

static void find_control(const metrics_signal *s, size_t i, control *result) {
  const size_t count = 2 * s->orders, c = s->channels;
  const double *terms = terms_of(s, i);
  result->points = count;
  result->channels = c;
  memset(result->values, 0, sizeof result->values);
  for (size_t row = 0; row < count; row++)
    for (size_t k = 0; k < count; k++)
      for (size_t j = 0; j < c; j++) result->values[row * c + j] += s->control[row * count + k] * terms[k * c + j];
}

static double bound_of(const control *piece) {
  double bound = 0.0;
  for (size_t i = 0; i < piece->points; i++)
    bound = larger(bound, norm(piece->values + i * piece->channels, piece->channels));
  return bound;
}

static double first_of(const control *piece) { return norm(piece->values, piece->channels); }

static double last_of(const control *piece) {
  return norm(piece->values + (piece->points - 1) * piece->channels, piece->channels);
}

/* both halves, by de Casteljau's algorithm: the second one replaces the piece */
static void bisect(control *piece, control *first) {
  const size_t c = piece->channels, count = piece->points;
  double *level = piece->values;
  *first = *piece;
  for (size_t i = 1; i < count; i++) {
    for (size_t k = 0; k < (count - i) * c; k++) level[k] = 0.5 * (level[k] + level[k + c]);
    memcpy(first->values + i * c, level, c * sizeof(double));
  }
}

/* the largest norm of a piece, where it exceeds `best` */
static double climb(control *piece, double best, int bisections) {
  best = larger(best, larger(first_of(piece), last_of(piece)));
  if (bisections == 0 || !(bound_of(piece) > best * (1.0 + PEAK_TOLERANCE))) return best;
  control first;
  bisect(piece, &first);
  best = climb(&first, best, bisections - 1);
  return climb(piece, best, bisections - 1);
}

/* the largest norm at 4 m equidistant times of a segment */
static double reached_in(const metrics_signal *s, size_t i) {
  const size_t m = s->orders, c = s->channels, samples = 4 * m;
  const double *terms = terms_of(s, i);
  double largest = 0.0;
  for (size_t row = 0; row < samples; row++) {
    const double theta = (double)row / (double)(samples - 1), rest = 1.0 - theta;
    double value[METRICS_CHANNELS] = {0.0};
    for (size_t k = m; k-- > 0;)
      for (size_t j = 0; j < c; j++)
        value[j] = value[j] * theta * rest + rest * terms[k * c + j] + theta * terms[(m + k) * c + j];
    largest = larger(largest, norm(value, c));
  }
  return largest;
}

void metrics_peak(const metrics_signal *s, double result[2]) {
  double best = 0.0, with_error = 0.0, doubtful = 0.0;
  for (size_t i = 0; i < s->segments; i++) {
    best = larger(best, s->ends[i]);
    with_error = larger(with_error, s->ends[i] + s->errors[i]);
    doubtful += 0.0 * s->bounds[i];
  }
  const double at_ends = best;
  double reached = -1.0, exceeded = 0.0, error = 0.0;
  for (size_t i = 0; i < s->segments; i++) {
    /* only segments that may reach the peak, with or without their error */
    if (s->bounds[i] < at_ends && s->bounds[i] + s->errors[i] < with_error) continue;
    const double here = reached_in(s, i);
    exceeded = larger(exceeded, here + s->errors[i]);
    if (here > reached) {
      reached = here;
      error = s->errors[i];
    }
    if (s->bounds[i] > best) {
      control piece;
      find_control(s, i, &piece);
      best = climb(&piece, best, MAXIMUM_BISECTIONS);
    }
  }
  result[0] = best + doubtful;
  result[1] = larger(exceeded - best, error);
}

/* the last theta from `left` to `right` at which the norm of a piece is at least the level; -1 if there is none */
static double last_theta(control *piece, double left, double right, double level) {
  for (;;) {
    const double middle = 0.5 * (left + right);
    if (!(bound_of(piece) >= level)) return -1.0;
    if (last_of(piece) >= level || !(left < middle && middle < right)) return right;
    control first;
    bisect(piece, &first);
    const double found = last_theta(piece, middle, right, level);
    if (found >= 0.0) return found;
    *piece = first;
    right = middle;
  }
}

int metrics_last_above(const metrics_signal *s, double level, size_t *segment, double *theta) {
  for (size_t i = s->segments; i-- > 0;) {
    if (!(s->bounds[i] >= level)) continue;
    control piece;
    find_control(s, i, &piece);
    *theta = last_theta(&piece, 0.0, 1.0, level);
    *segment = i;
    if (*theta >= 0.0) return 1;
  }
  return 0;
}

/* the largest value of a piece times the sign, where it exceeds `best` by more than the tolerance */
static double climb_signed(control *piece, double sign, double tolerance, double best, int bisections) {
  double bound = best;
  best = larger(best, larger(sign * piece->values[0], sign * piece->values[piece->points - 1]));
  for (size_t i = 0; i < piece->points; i++) bound = larger(bound, sign * piece->values[i]);
  if (bisections == 0 || !(bound > best + tolerance)) return best;
  control first;
  bisect(piece, &first);
  best = climb_signed(&first, sign, tolerance, best, bisections - 1);
  return climb_signed(piece, sign, tolerance, best, bisections - 1);
}

/* adds the integrals of both parts over a piece: the mean of the control points where none has the other sign */
static void add_parts(control *piece, double width, double parts[2], int bisections) {
  double low = 0.0, high = 0.0, sum = 0.0;
  for (size_t i = 0; i < piece->points; i++) {
    const double value = piece->values[i];
    sum += value;
    low = value < low ? value : low;
    high = larger(high, value);
  }
  if (bisections == 0 || !(low < 0.0 && high > 0.0)) {
    parts[sum < 0.0] += width * fabs(sum) / (double)piece->points;
    return;
  }
  control first;
  bisect(piece, &first);
  add_parts(&first, 0.5 * width, parts, bisections - 1);
  add_parts(piece, 0.5 * width, parts, bisections - 1);
}

void metrics_parts(const metrics_signal *s, double result[7]) {
  double size = 0.0, doubtful = 0.0;
  for (size_t i = 0; i < 7; i++) result[i] = 0.0;
  for (size_t i = 0; i < s->segments; i++) {
    size = larger(size, s->ends[i]);
    doubtful += 0.0 * s->bounds[i];
  }
  for (size_t i = 0; i < s->segments; i++) {
    control piece, copy;
    /* the sign is that of the first term, unless the others may exceed it */
    const double start = terms_of(s, i)[0], end = terms_of(s, i)[s->orders];
    const double rest = s->bounds[i] - s->ends[i];
    const int positive = start >= rest && end >= rest, negative = start <= -rest && end <= -rest;
    const int high = s->bounds[i] > result[0] && !negative, low = s->bounds[i] > result[1] && !positive;
    const int mixed = !positive && !negative;
    if (!negative) result[5] += s->errors[i] * s->duration[i];
    if (!positive) result[6] += s->errors[i] * s->duration[i];
    if (mixed || high || low) find_control(s, i, &piece);
    for (size_t k = 0; k < 2; k++) {
      if (!(k ? low : high)) continue;
      copy = piece;
      result[k] = climb_signed(&copy, k ? -1.0 : 1.0, PEAK_TOLERANCE * size, result[k], MAXIMUM_BISECTIONS);
    }
    if (mixed) {
      add_parts(&piece, s->duration[i], result + 2, ZERO_BISECTIONS);
      continue;
    }
    /* the integral of (theta (1 - theta))^k theta is half of k!^2 / (2 k + 1)! */
    double sum = 0.0, weight = 0.5;
    for (size_t k = 0; k < s->orders; k++) {
      sum += weight * (terms_of(s, i)[k] + terms_of(s, i)[s->orders + k]);
      weight *= (double)(k + 1) / (double)(4 * k + 6);
    }
    result[2 + !positive] += s->duration[i] * fabs(sum);
  }
  /* errors of the segments that may reach the smaller extreme */
  const double least = result[0] < result[1] ? result[0] : result[1];
  for (size_t i = 0; i < s->segments; i++)
    if (s->bounds[i] + s->errors[i] >= least) result[4] = larger(result[4], s->errors[i]);
  for (size_t i = 0; i < 7; i++) result[i] += doubtful;
}

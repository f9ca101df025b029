/* Integrals of products of a derivative and its estimated deviation, by Gauss quadrature. */
#include "arithmetic.h"

/* the largest norm of a derivative of the last term over theta, from the rows of `last` */
static double last_term(const metrics_signal *s, size_t i, const double *last) {
  const size_t m = s->orders, c = s->channels;
  const double *alpha = terms_of(s, i) + (m - 1) * c, *beta = terms_of(s, i) + (2 * m - 1) * c;
  double largest = 0.0;
  for (size_t row = 0; row < METRICS_SAMPLES; row++) {
    double value[METRICS_CHANNELS];
    for (size_t j = 0; j < c; j++) value[j] = last[2 * row] * alpha[j] + last[2 * row + 1] * beta[j];
    largest = larger(largest, norm(value, c));
  }
  return largest;
}

/* the derivative in segment i at all points, of one channel after the other */
static void find_values(const metrics_signal *s, const metrics_quadrature *q, size_t i, double *values) {
  const size_t c = s->channels;
  const double *terms = terms_of(s, i), scale = 1.0 / power(s->duration[i], q->order);
  const size_t m = s->orders, lowest = q->order > 1; /* the first term is linear */
  for (size_t j = 0; j < c; j++) {
    double *value = values + j * METRICS_POINTS;
    for (size_t point = 0; point < q->points; point++) value[point] = 0.0;
    for (size_t k = lowest; k < m; k++) {
      const double alpha = scale * terms[k * c + j], *start = q->values + k * q->points;
      const double beta = scale * terms[(m + k) * c + j], *end = q->values + (m + k) * q->points;
      for (size_t point = 0; point < q->points; point++) value[point] += start[point] * alpha + end[point] * beta;
    }
  }
}

/* its deviation in channel j: estimated from the nodes, or where these are unknown, all in the direction of the derivative;
 * where orders were left out, with the last that was kept */
static void find_deviation(const metrics_signal *s, const metrics_quadrature *q, size_t i, size_t j, double change,
                           const double *values, double *deviation) {
  const size_t m = s->orders, c = s->channels, last = s->kept[i] - 1;
  const double start = s->jumps[i * c + j], end = s->jumps[(i + 1) * c + j];
  const double mean = isnan(start) ? end : isnan(end) ? start : 0.5 * (start + end);
  const double size = mean * power(s->duration[i], 2 * m - q->order);
  for (size_t point = 0; point < q->points; point++) {
    deviation[point] = q->shape[point] * size;
    if (isnan(mean)) {
      double square = 0.0;
      for (size_t l = 0; l < c; l++) square += values[l * METRICS_POINTS + point] * values[l * METRICS_POINTS + point];
      deviation[point] = square > 0.0 ? values[j * METRICS_POINTS + point] / sqrt(square) * change : 0.0;
    }
  }
  if (last + 1 == m) return;
  const double scale = 1.0 / power(s->duration[i], q->order);
  const double alpha = scale * terms_of(s, i)[last * c + j], beta = scale * terms_of(s, i)[(m + last) * c + j];
  for (size_t point = 0; point < q->points; point++)
    deviation[point] += q->values[last * q->points + point] * alpha + q->values[(m + last) * q->points + point] * beta;
}

void metrics_products(const metrics_signal *s, const metrics_quadrature *q, double result[3]) {
  result[0] = result[1] = result[2] = 0.0;
  for (size_t i = 0; i < s->segments; i++) {
    const int alone = isnan(s->jumps[i * s->channels]) && isnan(s->jumps[(i + 1) * s->channels]);
    const double change = alone ? last_term(s, i, q->last) / power(s->duration[i], q->order) : 0.0;
    double values[METRICS_CHANNELS * METRICS_POINTS], deviation[METRICS_POINTS];
    find_values(s, q, i, values);
    for (size_t j = 0; j < s->channels; j++) {
      const double *value = values + j * METRICS_POINTS;
      double squares = 0.0, common = 0.0, deviations = 0.0;
      find_deviation(s, q, i, j, change, values, deviation);
      for (size_t point = 0; point < q->points; point++) {
        squares += q->weights[point] * value[point] * value[point];
        common += q->weights[point] * value[point] * deviation[point];
        deviations += q->weights[point] * deviation[point] * deviation[point];
      }
      result[0] += s->duration[i] * squares;
      result[1] += s->duration[i] * common;
      result[2] += s->duration[i] * deviations;
    }
  }
}

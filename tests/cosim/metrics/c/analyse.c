/* Analyses a signal from the standard input with the C code of the metrics, every array in memory of its own exact size, so
 * that the sanitizers notice any access beside it. Prints the results as hexadecimal floating-point numbers. */
#include "metrics.h"

#include <stdio.h>
#include <stdlib.h>

static double *allocated(size_t count) {
  double *memory = malloc(count * sizeof(double) + !count);
  if (!memory) exit(2);
  return memory;
}

static double *read_array(size_t count) {
  double *memory = allocated(count);
  if (fread(memory, sizeof(double), count, stdin) != count) exit(3);
  return memory;
}

int main(void) {
  unsigned long long sizes[5];
  if (fread(sizes, sizeof *sizes, 5, stdin) != 5) return 3;
  const size_t n = sizes[0], c = sizes[1], m = sizes[2], points = sizes[3];
  metrics_signal s = {.segments = n, .channels = c, .orders = m, .left_stride = n * c, .right_stride = n * c};
  double *level = read_array(1);
  double *input[] = {read_array(n), read_array(m * n * c), read_array(m * n * c), read_array(4 * m * m), read_array(2 * m)};
  s.duration = input[0];
  s.left = input[1];
  s.right = input[2];
  s.control = input[3];
  s.highest = input[4];
  double *output[] = {allocated(2 * m * n * c), allocated(n), allocated(n), allocated(n), allocated((n + 1) * c)};
  s.terms = output[0];
  s.ends = output[1];
  s.bounds = output[2];
  s.errors = output[3];
  s.jumps = output[4];
  s.kept = malloc(n * sizeof *s.kept);
  double *parts[] = {read_array(points), read_array(2 * m * points), read_array(points), read_array(2 * METRICS_SAMPLES)};
  const metrics_quadrature q = {points, sizes[4], parts[0], parts[1], parts[2], parts[3]};
  double peak[2], products[3], parts_of[7] = {0.0}, theta = -1.0;
  size_t segment = 0;
  const size_t diverging = metrics_prepare(&s);
  metrics_peak(&s, peak);
  metrics_products(&s, &q, products);
  if (c == 1) metrics_parts(&s, parts_of);
  const int found = metrics_last_above(&s, *level, &segment, &theta);
  printf("%zu %a %a %a %a %a %d %zu %a\n", diverging, peak[0], peak[1], products[0], products[1], products[2], found, segment,
         theta);
  for (size_t i = 0; i < 7; i++) printf("%a\n", parts_of[i]);
  for (size_t i = 0; i < 5; i++) free(input[i]), free(output[i]);
  for (size_t i = 0; i < 4; i++) free(parts[i]);
  free(level);
  free(s.kept);
  return 0;
}

/* Interpolates two signals in arrays of their exact sizes; returns 0 where the sums are right. */
#include "dense.h"

#include <stdlib.h>

enum { POINTS = 5, ROWS = 6, INSTANTS = 3, ORDERS = 2, SIGNALS = 2, HIGHEST = 3 };

int main(void) {
  const long long begins[INSTANTS] = {0, 0, 1}, points[INSTANTS] = {-1, 4, -1};
  /* values of both signals, first and second derivatives; the second one is interpolated as a derivative of the first */
  const long long signals[5 * SIGNALS] = {0, 2, 0, 2, 0, 0, 2, 1, 2, 1};
  double *table = malloc(ROWS * POINTS * sizeof *table), *found = malloc(SIGNALS * ORDERS * INSTANTS * sizeof *found);
  double *weights = malloc(12 * INSTANTS * HIGHEST * sizeof *weights);
  if (!table || !found || !weights) return 2;
  for (int i = 0; i < ROWS * POINTS; i++) table[i] = i;
  for (int i = 0; i < 12 * INSTANTS * HIGHEST; i++) weights[i] = 1 + i / (12 * INSTANTS);
  const master_dense dense = {INSTANTS, begins, points, weights};
  master_interpolate(&dense, table, POINTS, signals, SIGNALS, ORDERS, found);
  int wrong = 0;
  for (int s = 0; s < SIGNALS; s++)
    for (int n = 0; n < ORDERS; n++)
      for (int i = 0; i < INSTANTS; i++) {
        double sum = table[(s + 2 * n) * POINTS + 4];
        if (points[i] < 0) {
          sum = 0.0;
          for (int row = 0; row < ROWS; row += 2)
            for (int k = 0; k < 4; k++) sum += (s + n + 1) * table[row * POINTS + begins[i] + k];
        }
        wrong += found[(s * ORDERS + n) * INSTANTS + i] != sum;
      }
  free(table);
  free(found);
  free(weights);
  return wrong > 0;
}

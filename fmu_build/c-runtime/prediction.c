#include "prediction.h"

#include <math.h>
#include <string.h>

// value at x of the polynomial of Lagrange through (nodes, values)
static void interpolate(int n, int n_nodes, const double *nodes, const double *const *values, double x, double *result) {
  memset(result, 0, (size_t)n * sizeof *result);
  for (int j = 0; j < n_nodes; j++) {
    double above = 1.0, below = 1.0;
    for (int k = 0; k < n_nodes; k++)
      if (k != j) above *= x - nodes[k], below *= nodes[j] - nodes[k];
    double weight = above / below;
    for (int c = 0; c < n; c++) result[c] += weight * values[j][c];
  }
}

// whether the end of a step is a node besides those of the method
static int adds_end(const flex_tableau *tableau) {
  return tableau->c[tableau->stages - 1] < 1.0;
}

void flex_predict(int n, const flex_tableau *tableau, const flex_history *history, double first, double ratio,
                  double *prediction) {
  int s = tableau->stages, n_nodes = history->end && adds_end(tableau) ? s + 2 : s + 1;
  double nodes[FLEX_MAX_STAGES + 2];
  const double *values[FLEX_MAX_STAGES + 2];
  nodes[0] = 0.0;
  values[0] = history->start;
  for (int i = 0; i < s; i++) {
    nodes[i + 1] = tableau->c[i];
    values[i + 1] = history->stages + i * n;
  }
  nodes[s + 1] = 1.0;
  values[s + 1] = history->end;
  for (int i = 0; i < s; i++) interpolate(n, n_nodes, nodes, values, first + ratio * tableau->c[i], prediction + i * n);
}

double flex_prediction_reach(const flex_tableau *tableau, double history, double h) {
  int order = tableau->stages + 1 + adds_end(tableau);
  double x = 1.0 + h / history, reach = adds_end(tableau) ? x * (x - 1.0) : x;
  for (int i = 0; i < tableau->stages; i++) reach *= x - tableau->c[i];
  return reach * pow(history, order);
}

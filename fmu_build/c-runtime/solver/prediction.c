/* Extrapolation of stage accelerations by Lagrange's formula through the stages of the step before (Hairer and Wanner, Solving
 * Ordinary Differential Equations II, section IV.8, starting values). */
#include "prediction.h"

#include <math.h>
#include <string.h>

#include "elementary.h"

#include "linear_algebra.h"
#include "powers.h"

// weights of the values at the nodes in the value at x of the polynomial of Lagrange
static void interpolation_weights(int n_nodes, const double *nodes, double x, double *weights) {
  for (int j = 0; j < n_nodes; j++) {
    double above = 1.0, below = 1.0;
    for (int k = 0; k < n_nodes; k++)
      if (k != j) above *= x - nodes[k], below *= nodes[j] - nodes[k];
    weights[j] = above / below;
  }
}

void flex_predict(int n, const flex_tableau *tableau, const flex_history *history, double first, double ratio,
                  real *prediction) {
  int s = tableau->stages, n_nodes = history->has_end && !flex_ends_in_stage(tableau) ? s + 2 : s + 1;
  double nodes[FLEX_MAX_STAGES + 2], weights[FLEX_MAX_STAGES + 2];

  // nodes: the start of the step, its stages and, where it is known and no stage, its end
  nodes[0] = 0.0;
  memcpy(nodes + 1, tableau->c, (size_t)s * sizeof *nodes);
  nodes[s + 1] = 1.0;

  // value of the polynomial at each stage of the new step
  for (int i = 0; i < s; i++) {
    interpolation_weights(n_nodes, nodes, first + ratio * tableau->c[i], weights);
    flex_combine(n, n_nodes, weights, history->values, prediction + i * n);
  }
}

double flex_prediction_reach(const flex_tableau *tableau, double history, double h) {
  // remainder of the interpolation: the product of the distances to all nodes, at the end of the new step
  int adds_end = !flex_ends_in_stage(tableau), order = tableau->stages + 1 + adds_end;
  double x = 1.0 + h / history, reach = adds_end ? x * (x - 1.0) : x;
  for (int i = 0; i < tableau->stages; i++) reach *= x - tableau->c[i];
  return reach * flex_whole_power(history, order);
}

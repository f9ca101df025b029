/* Prediction of stage accelerations by the polynomial through those of another step. */
#ifndef FLEXFMU_PREDICTION_H
#define FLEXFMU_PREDICTION_H

#include "real.h"
#include "tableaus.h"

/* accelerations of a step at its start, its nodes and, if that is known, its end: [(stages + 2) n] or [(stages + 1) n] */
typedef struct {
  const real *values;
  int has_end;
} flex_history;

/* prediction [stages n] at first + ratio c_i, in units of the step that the history is about: 1 and h'/h for the next one */
void flex_predict(int n, const flex_tableau *tableau, const flex_history *history, double first, double ratio,
                  real *prediction);

/* growth of the error of a prediction for a step h after one of size history: the product of the distances to the nodes */
double flex_prediction_reach(const flex_tableau *tableau, double history, double h);

#endif

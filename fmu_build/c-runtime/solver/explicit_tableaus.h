/* Explicit Runge-Kutta methods as data: nodes c, matrix A, weights b. */
#ifndef FLEXFMU_EXPLICIT_TABLEAUS_H
#define FLEXFMU_EXPLICIT_TABLEAUS_H

#include "private.h"

#define FLEX_MAX_EXPLICIT_STAGES 7

typedef struct {
  int stages, order;
  int is_embedded; /* 1 = b_error estimates the error; 0 = two steps of half the size do */
  int ends_last;   /* 1 = the last stage is the end of the step, and so the first of the next one */
  double c[FLEX_MAX_EXPLICIT_STAGES];
  double b[FLEX_MAX_EXPLICIT_STAGES];
  double b_error[FLEX_MAX_EXPLICIT_STAGES]; /* b minus the weights of the embedded method */
  double a[FLEX_MAX_EXPLICIT_STAGES][FLEX_MAX_EXPLICIT_STAGES];
} flex_explicit_tableau;

FLEX_PRIVATE const flex_explicit_tableau flex_dormand_prince, flex_runge_kutta_4;

#endif

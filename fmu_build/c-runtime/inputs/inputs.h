/* Inputs as polynomials in time: u(base + tau) = sum of coefficient_k tau^k, one base and degree for every input. */
#ifndef FLEXFMU_INPUTS_H
#define FLEXFMU_INPUTS_H

#include "real.h"

typedef struct {
  int count, order;     /* number of inputs, highest order of a derivative */
  real *coefficients; /* (order + 1) for every input, normalised: k-th derivative / k! */
  double *base;       /* [s] */
  int *degree;          /* highest order in use */
  int *given;           /* 1 = set by the importer */
} flex_inputs;

void flex_inputs_take(flex_inputs *inputs, int count, int order, flex_arena *arena);

/* forgets everything that was set */
void flex_inputs_clear(flex_inputs *inputs);

/* a constant value from `time` on */
void flex_inputs_set(flex_inputs *inputs, int index, double time, real value);

/* the value of an input that was never set; derivatives that were set stay */
void flex_inputs_default(flex_inputs *inputs, int index, real value);

/* the same polynomial, expanded about another time */
void flex_inputs_expand(flex_inputs *inputs, int index, double time);

static inline double flex_factorial(int order) {
  static const double first[] = {1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0, 5040.0, 40320.0, 362880.0};
  const int last = (int)(sizeof first / sizeof *first) - 1;
  double product = first[order < last ? order : last];
  for (int k = last + 1; k <= order; k++) product *= k;
  return product;
}

/* the derivative of the given order at `time`; the rest of the polynomial stays. An importer may set dozens in every step */
static inline void flex_inputs_set_derivative(flex_inputs *inputs, int index, double time, int order, real value) {
  if (inputs->base[index] != time) flex_inputs_expand(inputs, index, time);
  inputs->coefficients[index * (inputs->order + 1) + order] = value / flex_factorial(order);
  if (order > inputs->degree[index]) inputs->degree[index] = order;
}

/* values at time + offset; kept apart since the sum would lose the digits of short steps */
void flex_inputs_evaluate(const flex_inputs *inputs, double time, double offset, real *u);

/* values at four offsets, side by side: four numbers for each input */
void flex_inputs_evaluate_lanes(const flex_inputs *inputs, double time, const double *offsets, real *u);

/* the derivative of an input at `time`, of any order */
real flex_inputs_derivative(const flex_inputs *inputs, int index, double time, int order);

/* first and second time derivatives at `time` */
void flex_inputs_rates(const flex_inputs *inputs, double time, real *u1, real *u2);

#endif

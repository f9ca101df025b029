#include "inputs.h"

#include <string.h>

#ifdef FLEX_IN_LANES
#include "lanes_stages.h"
#endif

void flex_inputs_take(flex_inputs *inputs, int count, int order, flex_arena *arena) {
  inputs->count = count;
  inputs->order = order;
  inputs->coefficients = flex_take_reals(arena, (size_t)count * (size_t)(order + 1));
  inputs->base = flex_take_doubles(arena, (size_t)count);
  inputs->degree = flex_take_ints(arena, (size_t)count);
  inputs->given = flex_take_ints(arena, (size_t)count);
}

static real *polynomial(const flex_inputs *inputs, int index) {
  return inputs->coefficients + index * (inputs->order + 1);
}

void flex_inputs_clear(flex_inputs *inputs) {
  for (int i = 0; i < inputs->count; i++) {
    flex_inputs_set(inputs, i, 0.0, flex_real(0.0));
    inputs->given[i] = 0;
  }
}

void flex_inputs_set(flex_inputs *inputs, int index, double time, real value) {
  real *c = polynomial(inputs, index);
  memset(c, 0, (size_t)(inputs->order + 1) * sizeof *c);
  c[0] = value;
  inputs->base[index] = time;
  inputs->degree[index] = 0;
  inputs->given[index] = 1;
}

void flex_inputs_default(flex_inputs *inputs, int index, real value) {
  polynomial(inputs, index)[0] = value;
}

// taylor shift
void flex_inputs_expand(flex_inputs *inputs, int index, double time) {
  real *c = polynomial(inputs, index);
  double shift = time - inputs->base[index];
  int degree = inputs->degree[index];
  if (shift != 0.0)
    for (int i = 0; i < degree; i++)
      for (int k = degree - 1; k >= i; k--) c[k] += shift * c[k + 1];
  inputs->base[index] = time;
}

void flex_inputs_evaluate(const flex_inputs *inputs, double time, double offset, real *u) {
  for (int i = 0; i < inputs->count; i++) {
    const real *c = polynomial(inputs, i);
    double tau = time - inputs->base[i] + offset;
    if (tau == 0.0) {
      u[i] = c[0];
      continue;
    }
    real value = c[inputs->degree[i]];
    for (int k = inputs->degree[i] - 1; k >= 0; k--) value = value * tau + c[k];
    u[i] = value;
  }
}

#ifdef FLEX_IN_LANES
void flex_inputs_evaluate_lanes(const flex_inputs *inputs, double time, const double *offsets, double *u) {
  for (int i = 0; i < inputs->count; i++, u += FLEX_MAX_STAGES) {
    const double *c = polynomial(inputs, i);
    flex_four tau = time - inputs->base[i] + flex_load_four(offsets);
    flex_four value = c[inputs->degree[i]] - (flex_four){0.0};
    for (int k = inputs->degree[i] - 1; k >= 0; k--) value = value * tau + c[k];
    flex_store_four(u, value);
  }
}
#endif

real flex_inputs_derivative(const flex_inputs *inputs, int index, double time, int order) {
  const real *c = polynomial(inputs, index);
  double tau = time - inputs->base[index];
  real value = flex_real(0.0);
  for (int k = inputs->degree[index]; k >= order; k--) value = value * tau + c[k] * (flex_factorial(k) / flex_factorial(k - order));
  return value;
}

void flex_inputs_rates(const flex_inputs *inputs, double time, real *u1, real *u2) {
  for (int i = 0; i < inputs->count; i++) {
    const real *c = polynomial(inputs, i);
    double tau = time - inputs->base[i];
    real value = flex_real(0.0), first = value, half_second = value;
    for (int k = inputs->degree[i]; k >= 0; k--) {
      half_second = half_second * tau + first;
      first = first * tau + value;
      value = value * tau + c[k];
    }
    u1[i] = first;
    u2[i] = 2.0 * half_second;
  }
}

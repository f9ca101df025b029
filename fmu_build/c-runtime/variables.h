/* The variables of a plant by index, with checks; reals are numbered inputs | parameters | outputs | fixed step.
 *
 * Every function returns 0, or 1 with a sentence in plant->message and nothing changed. */
#ifndef FLEXFMU_VARIABLES_H
#define FLEXFMU_VARIABLES_H

#include <math.h>

#include "plant.h"

/* integers: the choices of the start and the integrator, and what that has done */
enum {
  FLEX_INITIAL,
  FLEX_STEPS,
  FLEX_REJECTIONS,
  FLEX_EVALUATIONS,
  FLEX_ITERATIONS,
  FLEX_FACTORISATIONS,
  FLEX_INTEGRATOR,
  FLEX_N_INTEGERS
};

/* values of `initial` */
enum { FLEX_STATIC = 1, FLEX_UNDEFORMED = 2 };

int flex_set_real(flex_plant *plant, unsigned index, double value);
int flex_get_integer(flex_plant *plant, unsigned index, int *value);
int flex_set_integer(flex_plant *plant, unsigned index, int value);

/* 0 if there is such an input, and its derivative may have that order and value */
int flex_refuse_input_derivative(flex_plant *plant, unsigned index, int order, double value);

/* values that may have to be computed first, and time derivatives of outputs */
int flex_compute_real(flex_plant *plant, unsigned index, double *value);
int flex_compute_output_derivative(flex_plant *plant, unsigned index, int order, double *value);

/* which output has an index, or a number beyond all outputs */
static inline unsigned flex_output_of(const flex_model *model, unsigned index) {
  return index - (unsigned)(model->n_inputs + model->n_parameters);
}

/* an importer may set and read dozens of these in every step: short ways for what is there and needs no words */
static inline int flex_set_input_derivative(flex_plant *plant, unsigned index, int order, double value) {
  const flex_model *model = plant->model;
  int fits = index < (unsigned)model->n_inputs && order >= 1 && order <= model->max_input_order && isfinite(value);
  if (!fits) return flex_refuse_input_derivative(plant, index, order, value);
  flex_inputs_set_derivative(&plant->inputs, (int)index, plant->record->time, order, value);
  flex_plant_inputs_changed(plant);
  return 0;
}

static inline int flex_get_real(flex_plant *plant, unsigned index, double *value) {
  unsigned output = flex_output_of(plant->model, index);
  if (output >= (unsigned)plant->model->n_outputs || !flex_plant_has(plant, FLEX_HAVE_OUTPUTS))
    return flex_compute_real(plant, index, value);
  *value = plant->outputs[output];
  return 0;
}

static inline int flex_get_output_derivative(flex_plant *plant, unsigned index, int order, double *value) {
  unsigned output = flex_output_of(plant->model, index);
  int is_first = order == 1, needed = is_first ? FLEX_HAVE_FIRST_RATES : FLEX_HAVE_SECOND_RATES;
  if (output >= (unsigned)plant->model->n_outputs || order < 1 || order > 2 || !flex_plant_has(plant, needed))
    return flex_compute_output_derivative(plant, index, order, value);
  *value = (is_first ? plant->first_rates : plant->second_rates)[output];
  return 0;
}

/* the sentence for a failure; `what` begins it */
void flex_explain(flex_plant *plant, const char *what, const flex_failure *failure);

#endif

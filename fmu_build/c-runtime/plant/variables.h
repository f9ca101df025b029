/* The variables of a plant behind the FMI layer, by index, with checks; reals are numbered inputs | parameters | outputs | fixed step.
 *
 * Every function returns 0, or 1 with a sentence in plant->message and nothing changed. */
#ifndef FLEXFMU_VARIABLES_H
#define FLEXFMU_VARIABLES_H

#include <math.h>

#include "backend.h"
#include "plant.h"

typedef struct {
  flex_backend base;
  flex_plant *plant;
} plant_backend;

static inline flex_plant *plant_of(flex_backend *backend) { return ((plant_backend *)backend)->plant; }

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

/* 0 if there is such an input, and its derivative may have that order and value */
int flex_refuse_input_derivative(flex_plant *plant, unsigned index, int order, double value);

/* values that may have to be computed first, and time derivatives of outputs */
int flex_get_real(flex_plant *plant, unsigned index, double *value);
int flex_get_output_derivative(flex_plant *plant, unsigned index, int order, double *value);

/* the index of the first output */
static inline unsigned flex_first_output(const flex_model *model) {
  return (unsigned)(model->n_inputs + model->n_parameters);
}

/* which output has an index, or a number beyond all outputs */
static inline unsigned flex_output_of(const flex_model *model, unsigned index) { return index - flex_first_output(model); }

/* 0 if nothing has failed, else 1 with the sentence for the failure; `what` begins it */
int flex_explain(flex_plant *plant, const char *what, flex_failure failure);

#endif

/* Plants for tests: made, moved and freed in a line each. */
#ifndef FLEXFMU_TEST_PLANTS_H
#define FLEXFMU_TEST_PLANTS_H

#include "plant.h"

/* a plant with all input values and derivatives zero, ready for parameters */
flex_plant *make_plant(const flex_model *model, double tolerance);
void free_plant(flex_plant *plant);

/* begins a motion at the given positions and rates, inputs as they are */
void begin_at(flex_plant *plant, const double *y, const double *v);

/* begins in static equilibrium */
void begin_static(flex_plant *plant);

void set_input(flex_plant *plant, int index, double value);

/* advances by `count` communication steps of size h from `start`; stops the test if a step fails */
void advance(flex_plant *plant, double start, double h, int count);

/* begins undeformed, with input 0 rising at this speed */
void begin_pulled(flex_plant *plant, double speed);

/* advances, goes back and advances again: both ends must have the same bits */
void advance_twice(flex_plant *plant, double start, double h, int count);

/* value of an output after evaluating it */
double output(flex_plant *plant, int index);

#endif

/* Directional derivatives of a plant: what small changes of inputs, parameters and states make of its outputs.
 *
 * Only products with one direction are formed, by forward differentiation of the generated functions; the accelerations
 * change by M da = -(change of the residual without da). Before the motion the coordinates follow from inputs and parameters,
 * by the implicit function theorem where they are a static equilibrium. Inputs are held, also those that were never set. */
#ifndef FLEXFMU_DIRECTIONAL_H
#define FLEXFMU_DIRECTIONAL_H

#include "backend.h"
#include "plant.h"

/* changes of outputs with those of known variables; returns 0, or 1 with a sentence in plant->message */
int flex_differentiate(flex_plant *plant, const flex_direction *direction);

#endif

/* Directional derivatives of a plant: what small changes of inputs, parameters and states make of its outputs.
 *
 * Only products with one direction are formed, by forward differentiation of the generated functions; the accelerations
 * change by M da = -(change of the residual without da). At the start of the motion the coordinates follow from inputs and
 * parameters, by the implicit function theorem where they are a static equilibrium; there inputs that nobody has set follow
 * from the parameters too, as they do when a parameter is set. */
#ifndef FLEXFMU_DIRECTIONAL_H
#define FLEXFMU_DIRECTIONAL_H

#include "backend.h"
#include "plant.h"

/* changes of outputs with those of known variables; returns 0, or 1 with a sentence in plant->message */
int flex_differentiate(flex_plant *plant, const flex_direction *direction);

#endif

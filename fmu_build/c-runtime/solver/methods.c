#include "methods.h"

#include "integration_step.h"

/* below this tolerance Gauss with four stages is cheaper than three stages of either kind: measured on the five-bar with 12
 * coordinates and communication steps of 0.2 to 5 ms. Above, Radau needs two thirds of the time of Gauss, since its last
 * stage is the end of the step; but what it takes out of undamped vibrations adds up to several times the tolerance. */
#define FOUR_STAGES_TOLERANCE 3e-7

static const flex_method methods[] = {
    [FLEX_GAUSS_2] = {4, 5, flex_collocation_step, &flex_gauss_2, 0, 0},
    [FLEX_GAUSS_3] = {6, 7, flex_collocation_step, &flex_gauss_3, 0, 0},
    [FLEX_GAUSS_4] = {8, 9, flex_collocation_step, &flex_gauss_4, 0, 0},
    [FLEX_RADAU_3] = {5, 6, flex_collocation_step, &flex_radau_3, 0, 0},
    [FLEX_DORMAND_PRINCE] = {5, 5, flex_explicit_step, 0, &flex_dormand_prince, 0},
    [FLEX_RUNGE_KUTTA_4] = {4, 5, flex_explicit_step, 0, &flex_runge_kutta_4, 0},
    [FLEX_RADAU_3_DENSE] = {5, 6, flex_collocation_step, &flex_radau_3, 0, 1},
};

static int automatic(double tolerance, int is_damped, int is_overdamped) {
  if (is_overdamped) return FLEX_RADAU_3;
  if (tolerance < FOUR_STAGES_TOLERANCE) return FLEX_GAUSS_4;
  return is_damped ? FLEX_RADAU_3 : FLEX_GAUSS_3;
}

const flex_method *flex_find_method(int number, double tolerance, int is_damped, int is_overdamped) {
  return &methods[number == FLEX_AUTOMATIC ? automatic(tolerance, is_damped, is_overdamped) : number];
}

#include "methods.h"

#include "integration_step.h"

/* below this tolerance four stages are cheaper than three: measured on the five-bar with 12 coordinates, where three of them
 * need 4000 iterated stages for 1e-5 in free steps against 3000 for four, but communication steps of 0.2 ms are short enough
 * for three down to 1e-7 */
#define FOUR_STAGES_TOLERANCE 3e-7

static const flex_method methods[] = {
    [FLEX_GAUSS_2] = {4, 5, flex_collocation_step, &flex_gauss_2, 0},
    [FLEX_GAUSS_3] = {6, 7, flex_collocation_step, &flex_gauss_3, 0},
    [FLEX_GAUSS_4] = {8, 9, flex_collocation_step, &flex_gauss_4, 0},
    [FLEX_RADAU_3] = {5, 6, flex_collocation_step, &flex_radau_3, 0},
    [FLEX_DORMAND_PRINCE] = {5, 5, flex_explicit_step, 0, &flex_dormand_prince},
    [FLEX_RUNGE_KUTTA_4] = {4, 5, flex_explicit_step, 0, &flex_runge_kutta_4},
};

const flex_method *flex_find_method(int number, double tolerance) {
  if (number == FLEX_AUTOMATIC) number = tolerance < FOUR_STAGES_TOLERANCE ? FLEX_GAUSS_4 : FLEX_GAUSS_3;
  return &methods[number];
}

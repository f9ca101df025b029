#include "explicit_tableaus.h"

// clang-format off

/* the classical method of order 4 (Kutta 1901; Hairer, Norsett, Wanner: Solving ODEs I, table II.1.2) */
const flex_explicit_tableau flex_runge_kutta_4 = {
  .stages = 4, .order = 4,
  .c = {0.0, 0.5, 0.5, 1.0},
  .b = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6},
  .a = {{0.0}, {0.5}, {0.0, 0.5}, {0.0, 0.0, 1.0}},
};

/* Small models with known motions, written by hand in the form of generated ones. */
#ifndef FLEXFMU_TEST_MODELS_H
#define FLEXFMU_TEST_MODELS_H

#include <string.h>

#include "model.h"

typedef const double **in;
typedef double **out;

/* functions of a model: in general, with one result, with the same results always, and with the first n numbers of the first argument */
#define EQUATION(name) static int name(in arg, out res, int *iw, double *w, int mem)
#define FORMULA(name, result) \
  EQUATION(name) {            \
    res[0][0] = (result);     \
    return 0;                 \
  }
#define CONSTANT(name, ...)                        \
  EQUATION(name) {                                 \
    static const double results[] = {__VA_ARGS__}; \
    memcpy(res[0], results, sizeof results);       \
    return 0;                                      \
  }
#define COPY(name, n)                         \
  EQUATION(name) {                            \
    memcpy(res[0], arg[0], n * sizeof **arg); \
    return 0;                                 \
  }
#define FUNCTION(f) {f, 10, 1, 0, 0}

/* three oscillators y'' + 2 zeta w y' + w^2 (y - u) = 0, the first two mixed by a rotation, the third as stiff as you like;
 * parameters: three angular frequencies and one damping ratio; static equilibrium y = u;
 * outputs: the three coordinates in the mixed frame, their rates and accelerations */
extern const flex_model oscillators;

/* a pendulum of unit length and mass in unit gravity, y'' + sin(y) = u; one output: its energy */
extern const flex_model pendulum;

/* double pendulum of unit lengths and masses in unit gravity: a mass matrix that changes; one output: its energy */
extern const flex_model double_pendulum;

/* no unknowns: outputs are the square of the input and its margin 1 - u */
extern const flex_model rigid;

/* y'' + y = force + load, which gives NaN where y exceeds `limit`, with the margin 2 - force, at least 0.5; one output: y;
 * `limit` is fixed, `load` tunable; this is flex_the_model too */
extern const flex_model fragile;

/* two bodies of unit mass on the ground, the first pulled by a spring of stiffness 4 whose end is input 0, the second hung on
 * the first by one of stiffness `coupling`; both feel dry friction, c while they slip and up to b while they stick, but for a
 * viscous share `viscous`; parameters and derived values c, b, viscous, coupling, then the two directions;
 * outputs: positions, rates and friction forces */
extern const flex_model sliders;

#endif

#pragma GCC diagnostic ignored "-Wunused-parameter" // functions of models have CasADi's signature
#include "models.h"

#include <math.h>

#define LIMITLESS -HUGE_VAL, HUGE_VAL

/* the functions of a model, in the order of the contract */
#define FUNCTIONS(d, u, y, r, m, o, forward, rate1, rate2, start, margin, scale)                                     \
  .derive = FUNCTION(d), .initial_inputs = FUNCTION(u), .initial_coordinates = FUNCTION(y), .residual = FUNCTION(r), \
  .mass_matrix = FUNCTION(m), .outputs = FUNCTION(o), .motion_forward = FUNCTION(forward),                           \
  .motion_rate1 = FUNCTION(rate1), .motion_rate2 = FUNCTION(rate2), .start_forward = FUNCTION(start),                \
  .singularity = FUNCTION(margin), .error_scale = FUNCTION(scale), .default_tolerance = 1e-6

/* rates along the motion from directional derivatives, with v, a and du/dt as seeds; arg: y, v, a, u, u1, d */
#define RATE1(name, forward)                                                                        \
  EQUATION(name) {                                                                                  \
    static const double none[16];                                                                   \
    const double *seeds[] = {arg[0], arg[1], arg[2], arg[3], arg[5], arg[1], arg[2], arg[4], none}; \
    return forward(seeds, res, iw, w, mem);                                                         \
  }

/* also the `size` second rates of a linear model, with a, j and d2u/dt2 as seeds; arg: y, v, a, u, u1, d, j, u2 */
#define LINEAR_RATES(model, size)                                                                   \
  RATE1(model##_rate1, model##_forward)                                                             \
  EQUATION(model##_rate2) {                                                                         \
    static const double none[16];                                                                   \
    double changes[16], *result[] = {changes};                                                      \
    const double *seeds[] = {arg[0], arg[1], arg[2], arg[3], arg[5], arg[2], arg[6], arg[7], none}; \
    int refused = model##_forward(seeds, result, iw, w, mem);                                       \
    memcpy(res[0], changes, size * sizeof *changes);                                                \
    return refused;                                                                                 \
  }

/* a variable without limits that starts at zero */
#define FREE(name, unit) {name, unit, 0.0, LIMITLESS, 0}

/* functions that several models share */

static int origin(double *y, int n) {
  for (int i = 0; i < n; i++) y[i] = 0.0;
  return 0;
}

EQUATION(nothing) {
  return 0;
}

FORMULA(margin_below_one, 1.0 - arg[1][0])
FORMULA(margin_below_two, 2.0 - arg[1][0])

CONSTANT(origin_1, 0.0)
CONSTANT(origin_2, 0.0, 0.0)
CONSTANT(origin_3, 0.0, 0.0, 0.0)
CONSTANT(one, 1.0)
CONSTANT(unit_mass_2, 1.0, 0.0, 0.0, 1.0)
CONSTANT(unit_mass_3, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
CONSTANT(unit_scale_1, 1.0, 1.0, 1e-6)
CONSTANT(unit_scale_2, 1.0, 1.0, 1.0, 1.0, 1e-6)
CONSTANT(sliders_scale, 1.0, 1.0, 1.0, 1.0, 0.1) // positions, rates, and a floor of everyday size
COPY(first_1, 1)
COPY(first_2, 2)
COPY(first_4, 4)

/* oscillators: y = R q, R orthogonal; d = frequencies and damping ratio */

static const double rotation[3][3] = {{0.6, -0.8, 0.0}, {0.8, 0.6, 0.0}, {0.0, 0.0, 1.0}};

// x'' + 2 zeta w x' + w^2 (x - u) in the mixed frame
static void oscillators_balance(const double *y, const double *v, const double *a, const double *u, const double *d,
                                double *r) {
  double f[3];
  for (int k = 0; k < 3; k++) {
    double q = 0.0, p = 0.0;
    for (int i = 0; i < 3; i++) q += rotation[i][k] * (y[i] - u[i]), p += rotation[i][k] * v[i];
    f[k] = 2.0 * d[3] * d[k] * p + d[k] * d[k] * q;
  }
  for (int i = 0; i < 3; i++) {
    r[i] = a[i];
    for (int k = 0; k < 3; k++) r[i] += rotation[i][k] * f[k];
  }
}

EQUATION(oscillators_residual) {
  oscillators_balance(arg[0], arg[1], arg[2], arg[3], arg[4], res[0]);
  return 0;
}

EQUATION(oscillators_outputs) {
  for (int k = 0; k < 3; k++) memcpy(res[0] + 3 * k, arg[k], 3 * sizeof(double));
  return 0;
}

// arg: y, v, a, u, d, dy, dv, du, dd
EQUATION(oscillators_forward) {
  const double held[3] = {0.0, 0.0, 0.0};
  oscillators_balance(arg[5], arg[6], held, arg[7], arg[4], res[0]);

  // changes of frequencies and damping: d(2 zeta w) p + d(w^2) q
  for (int k = 0; k < 3; k++) {
    double q = 0.0, p = 0.0, frequency = arg[4][k], damping = arg[4][3];
    for (int i = 0; i < 3; i++) q += rotation[i][k] * (arg[0][i] - arg[3][i]), p += rotation[i][k] * arg[1][i];
    double f = 2.0 * (arg[8][3] * frequency + damping * arg[8][k]) * p + 2.0 * frequency * arg[8][k] * q;
    for (int i = 0; i < 3; i++) res[0][i] += rotation[i][k] * f;
  }

  // the outputs show y, v, a
  memcpy(res[0] + 3, arg[5], 3 * sizeof(double));
  memcpy(res[0] + 6, arg[6], 3 * sizeof(double));
  for (int i = 0; i < 3; i++) res[0][9 + i] = 0.0, res[0][12 + i] = 1.0;
  return 0;
}

// d changes with p, the start position does not
EQUATION(oscillators_start_forward) {
  memcpy(res[0], arg[1], 4 * sizeof(double));
  return origin(res[0] + 4, 3);
}

LINEAR_RATES(oscillators, 12)

// energy norm, without the products of different coordinates
EQUATION(oscillators_scale) {
  const double *d = arg[0];
  for (int i = 0; i < 3; i++) {
    res[0][i] = 0.0;
    for (int k = 0; k < 3; k++) res[0][i] += rotation[i][k] * rotation[i][k] * d[k] * d[k];
    res[0][3 + i] = 1.0;
  }
  res[0][6] = 1e-6;
  return 0;
}

static const flex_term shown_accelerations[] = {{6, 0}, {7, 1}, {8, 2}};
static const flex_variable oscillator_inputs[] = {
    FREE("equilibrium1", "m"), FREE("equilibrium2", "m"), FREE("equilibrium3", "m")};
static const flex_variable oscillator_parameters[] = {{"frequency1", "rad/s", 1.0, 0.0, 1e9, 0},
                                                      {"frequency2", "rad/s", 3.0, 0.0, 1e9, 0},
                                                      {"frequency3", "rad/s", 7.0, 0.0, 1e9, 0},
                                                      {"damping.ratio", "1", 0.0, 0.0, 10.0, 1}};
static const flex_variable oscillator_outputs[] = {FREE("y1", "m"),    FREE("y2", "m"),    FREE("y3", "m"),
                                                   FREE("v1", "m/s"),  FREE("v2", "m/s"),  FREE("v3", "m/s"),
                                                   FREE("a1", "m/s2"), FREE("a2", "m/s2"), FREE("a3", "m/s2")};

const flex_model oscillators = {
    .name = "oscillators", .guid = "{oscillators}", .n = 3, .n_inputs = 3, .n_parameters = 4, .n_derived = 4,
    .n_outputs = 9, .max_input_order = 9, .input_variables = oscillator_inputs,
    .parameter_variables = oscillator_parameters, .output_variables = oscillator_outputs, .n_acceleration_terms = 3,
    .acceleration_terms = shown_accelerations, .static_start = 1, .minimum_margin = 0.0, .margin_name = "margin",
    FUNCTIONS(first_4, origin_3, origin_3, oscillators_residual, unit_mass_3,
              oscillators_outputs, oscillators_forward, oscillators_rate1, oscillators_rate2,
              oscillators_start_forward, one, oscillators_scale)};

/* pendulum */

FORMULA(pendulum_residual, arg[2][0] + sin(arg[0][0]) - arg[3][0])
FORMULA(pendulum_energy, 0.5 * arg[1][0] * arg[1][0] - cos(arg[0][0]))

// arg: y, v, a, u, d, dy, dv, du, dd
EQUATION(pendulum_forward) {
  res[0][0] = cos(arg[0][0]) * arg[5][0] - arg[7][0];
  res[0][1] = arg[1][0] * arg[6][0] + sin(arg[0][0]) * arg[5][0];
  return 0;
}

RATE1(pendulum_rate1, pendulum_forward)

EQUATION(pendulum_rate2) {
  double y = arg[0][0], v = arg[1][0], a = arg[2][0];
  res[0][0] = -sin(y) * v * v + cos(y) * a - arg[7][0];
  res[0][1] = a * (a + sin(y)) + v * (arg[6][0] + cos(y) * v);
  return 0;
}

static const flex_variable torque_input[] = {{"torque", "N.m", 0.0, -10.0, 10.0, 0}};
static const flex_variable energy_output[] = {FREE("energy", "J")};

const flex_model pendulum = {
    .name = "pendulum", .guid = "{pendulum}", .n = 1, .n_inputs = 1, .n_outputs = 1, .max_input_order = 9,
    .input_variables = torque_input, .output_variables = energy_output, .static_start = 1, .margin_name = "margin",
    FUNCTIONS(nothing, origin_1, origin_1, pendulum_residual, one, pendulum_energy,
              pendulum_forward, pendulum_rate1, pendulum_rate2, origin_1, one, unit_scale_1)};

/* double pendulum with angles y from the vertical */

EQUATION(unknown_rates) {
  return 1;
}

EQUATION(double_pendulum_mass) {
  double c = cos(arg[0][0] - arg[0][1]);
  res[0][0] = 2.0, res[0][1] = res[0][2] = c, res[0][3] = 1.0;
  return 0;
}

EQUATION(double_pendulum_residual) {
  const double *y = arg[0], *v = arg[1], *a = arg[2];
  double c = cos(y[0] - y[1]), s = sin(y[0] - y[1]);
  res[0][0] = 2.0 * a[0] + c * a[1] + s * v[1] * v[1] + 2.0 * sin(y[0]);
  res[0][1] = c * a[0] + a[1] - s * v[0] * v[0] + sin(y[1]);
  return 0;
}

EQUATION(double_pendulum_energy) {
  const double *y = arg[0], *v = arg[1];
  res[0][0] = v[0] * v[0] + 0.5 * v[1] * v[1] + v[0] * v[1] * cos(y[0] - y[1]) - 2.0 * cos(y[0]) - cos(y[1]);
  return 0;
}

const flex_model double_pendulum = {
    .name = "double_pendulum", .guid = "{double_pendulum}", .n = 2, .n_outputs = 1,
    .output_variables = energy_output, .margin_name = "margin",
    FUNCTIONS(nothing, nothing, origin_2, double_pendulum_residual, double_pendulum_mass,
              double_pendulum_energy, unknown_rates, unknown_rates, unknown_rates, unknown_rates, one,
              unit_scale_2)};

/* rigid: u, u' and u'' of the input are all there is */

FORMULA(rigid_outputs, arg[3][0] * arg[3][0])

// arg: y, v, a, u, d, dy, dv, du, dd
FORMULA(rigid_forward, 2.0 * arg[3][0] * arg[7][0])

RATE1(rigid_rate1, rigid_forward)

FORMULA(rigid_rate2, 2.0 * (arg[4][0] * arg[4][0] + arg[3][0] * arg[7][0]))

static const flex_variable angle_input[] = {FREE("angle", "rad")};
static const flex_variable square_output[] = {FREE("square", "rad2")};

const flex_model rigid = {
    .name = "rigid", .guid = "{rigid}", .n_inputs = 1, .n_outputs = 1, .max_input_order = 9,
    .input_variables = angle_input, .output_variables = square_output, .static_start = 1, .minimum_margin = 0.0,
    .margin_name = "distance to the wall",
    FUNCTIONS(nothing, origin_1, nothing, nothing, nothing, rigid_outputs, rigid_forward,
              rigid_rate1, rigid_rate2, nothing, margin_below_one, one)};

/* sliders: d = c, b, viscous, coupling, direction 1, direction 2 */

EQUATION(sliders_derive) {
  memcpy(res[0], arg[0], 4 * sizeof(double));
  return origin(res[0] + 4, 2);
}

// forces without friction, with the acceleration that they need
static void sliders_forces(const double *y, const double *v, const double *a, const double *u, const double *d, double *r) {
  double link = d[3] * (y[1] - y[0]);
  r[0] = a[0] + d[2] * v[0] + 4.0 * (y[0] - u[0]) - link;
  r[1] = a[1] + d[2] * v[1] + link;
}

EQUATION(sliders_residual) {
  const double *d = arg[4];
  sliders_forces(arg[0], arg[1], arg[2], arg[3], d, res[0]);
  for (int i = 0; i < 2; i++) res[0][i] += d[4 + i] * d[0];
  return 0;
}

EQUATION(sliders_outputs) {
  memcpy(res[0], arg[0], 2 * sizeof(double));
  memcpy(res[0] + 2, arg[1], 2 * sizeof(double));
  sliders_forces(arg[0], arg[1], arg[2], arg[3], arg[4], res[0] + 4);
  return 0;
}

// arg: y, v, a, u, d, dy, dv, du, dd
EQUATION(sliders_forward) {
  const double held[2] = {0.0, 0.0};
  sliders_forces(arg[5], arg[6], held, arg[7], arg[4], res[0]);
  memcpy(res[0] + 2, arg[5], 2 * sizeof(double));
  memcpy(res[0] + 4, arg[6], 2 * sizeof(double));
  memcpy(res[0] + 6, res[0], 2 * sizeof(double));
  res[0][8] = res[0][9] = 1.0;
  return 0;
}

LINEAR_RATES(sliders, 8)

EQUATION(sliders_start_forward) {
  memcpy(res[0], arg[1], 4 * sizeof(double));
  return origin(res[0] + 4, 4);
}

static const flex_variable sliders_input[] = {FREE("pull", "m")};
static const flex_variable sliders_parameters[] = {{"c", "N", 1.0, 0.0, 1e9, 0},
                                                   {"b", "N", 1.5, 0.0, 1e9, 1},
                                                   {"viscous", "N.s/m", 0.0, 0.0, 1e9, 0},
                                                   {"coupling", "N/m", 0.0, 0.0, 1e9, 0}};
static const flex_variable sliders_shown[] = {FREE("y1", "m"),   FREE("y2", "m"), FREE("v1", "m/s"),
                                              FREE("v2", "m/s"), FREE("f1", "N"), FREE("f2", "N")};
static const flex_term sliders_terms[] = {{4, 0}, {5, 1}};
static const flex_friction sliders_frictions[] = {{0, 1, 4}, {1, 1, 5}};

const flex_model sliders = {
    .name = "sliders", .guid = "{sliders}", .n = 2, .n_inputs = 1, .n_parameters = 4, .n_derived = 6, .n_outputs = 6,
    .max_input_order = 9, .input_variables = sliders_input, .parameter_variables = sliders_parameters,
    .output_variables = sliders_shown, .n_acceleration_terms = 2, .acceleration_terms = sliders_terms,
    .n_frictions = 2, .frictions = sliders_frictions, .margin_name = "margin",
    FUNCTIONS(sliders_derive, origin_1, origin_2, sliders_residual, unit_mass_2, sliders_outputs, sliders_forward,
              sliders_rate1, sliders_rate2, sliders_start_forward, one, sliders_scale)};

/* fragile: d = limit, load */

EQUATION(fragile_residual) {
  const double *d = arg[4];
  res[0][0] = arg[0][0] > d[0] ? NAN : arg[2][0] + arg[0][0] - arg[3][0] - d[1];
  return 0;
}

// arg: y, v, a, u, d, dy, dv, du, dd
EQUATION(fragile_forward) {
  res[0][0] = arg[5][0] - arg[7][0] - arg[8][1];
  res[0][1] = arg[5][0];
  return 0;
}

LINEAR_RATES(fragile, 2)

// d changes with p, the start position does not
EQUATION(fragile_start_forward) {
  memcpy(res[0], arg[1], 2 * sizeof(double));
  return origin(res[0] + 2, 1);
}

static const flex_variable fragile_parameters[] = {{"limit", "m", 10.0, -HUGE_VAL, 100.0, 0},
                                                   {"load", "N", 0.0, -5.0, 5.0, 1}};
static const flex_variable force_input[] = {{"force", "N", 0.0, -100.0, 100.0, 0}};
static const int position_alone[] = {0, -1};
static const flex_variable position_output[] = {FREE("position", "m")};

// also the one that the FMI functions find
#define FRAGILE_MODEL                                                                                \
  {.name = "fragile", .guid = "{fragile}", .n = 1, .n_inputs = 1, .n_parameters = 2, .n_derived = 2, \
   .n_outputs = 1, .max_input_order = 3, .input_variables = force_input,                             \
   .parameter_variables = fragile_parameters, .output_variables = position_output,                   \
   .state_outputs = position_alone, .static_start = 1, .minimum_margin = 0.5,                        \
   .margin_name = "distance between the elbows (m)",                                                 \
   FUNCTIONS(first_2, origin_1, origin_1, fragile_residual, one, first_1,  \
             fragile_forward, fragile_rate1, fragile_rate2, fragile_start_forward, margin_below_two, \
             unit_scale_1)}

const flex_model fragile = FRAGILE_MODEL;
const flex_model flex_the_model = FRAGILE_MODEL;

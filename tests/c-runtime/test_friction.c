/* Friction that sticks, against the closed forms of stick-slip. */
#pragma GCC diagnostic ignored "-Wunused-parameter" // functions of models have CasADi's signature
#include <float.h>
#include <string.h>

#include "check.h"
#include "friction.h"
#include "models.h"
#include "plants.h"
#include "tests.h"

/* spring and mass of the first slider: angular frequency 2; friction of the model's start values */
#define W 2.0
#define STIFFNESS 4.0
#define C 1.0
#define B 1.5

#define PI 3.141592653589793

// the spring's end moves with V from t = 0, everything else starts at rest: position, rate and friction force at t.
// Sticks up to B, slips with C until the rate is zero; then the spring has gone from B to 2 C - B
static void stick_slip(double speed, double t, double *y, double *v, double *force) {
  double half = (B - C) / STIFFNESS, first = B / (STIFFNESS * speed);
  double slip = 2.0 * (PI - atan(half * W / speed)) / W, stick = 2.0 * (B - C) / (STIFFNESS * speed);
  double period = slip + stick, since = t - first, count = floor(since / period), phase = since - count * period;
  *y = *v = 0.0, *force = STIFFNESS * speed * t;
  if (since < 0.0) return;
  double start = count * speed * period;
  if (phase < slip) {
    double z = half * cos(W * phase) + speed / W * sin(W * phase), dz = speed * cos(W * phase) - half * W * sin(W * phase);
    *y = speed * (first + count * period + phase) - z - C / STIFFNESS;
    *v = speed - dz, *force = C;
  } else {
    *y = start + speed * period;
    *force = STIFFNESS * (speed * t - *y);
  }
}

// pulls the first slider from rest: position, rate and friction force follow the closed form, by every method
TEST(stick_slip_follows_its_closed_form) {
  const double tolerances[] = {1e-3, 1e-6, 1e-9}, speed = 0.3;
  for (int method = FLEX_AUTOMATIC; method <= FLEX_LAST_INTEGRATOR; method++)
    for (int k = 0; k < 3; k++) {
      flex_plant *plant = make_plant(&sliders, tolerances[k]);
      double y, v, force, worst = 0.0;
      plant->record->method = method;
      begin_pulled(plant, speed);
      for (int i = 0; i < 200; i++) {
        advance(plant, 0.1 * i, 0.1, 1);
        stick_slip(speed, 0.1 * (i + 1), &y, &v, &force);
        worst = fmax(worst, fmax(fabs(output(plant, 0) - y), fabs(output(plant, 2) - v)));
        worst = fmax(worst, fabs(output(plant, 4) + force));
      }
      CHECK_CLOSE(worst, 0.0, 3.0 * tolerances[k]);
      CHECK(plant->record->integrator.steps + plant->record->integrator.rejections < 250 / cbrt(tolerances[k]));
      free_plant(plant);
    }
}

// fixed steps end at events too: the classical method keeps its order over them
TEST(fixed_steps_end_at_events) {
  double worst[2] = {0.0, 0.0};
  for (int k = 0; k < 2; k++) {
    flex_plant *plant = make_plant(&sliders, 1e-6);
    double y, v, force;
    plant->record->method = FLEX_RUNGE_KUTTA_4;
    plant->record->fixed_step = k ? 0.05 : 0.1;
    begin_pulled(plant, 0.3);
    for (int i = 0; i < 20; i++) {
      advance(plant, i, 1.0, 1);
      stick_slip(0.3, i + 1.0, &y, &v, &force);
      worst[k] = fmax(worst[k], fabs(output(plant, 0) - y));
    }
    free_plant(plant);
  }
  CHECK_BETWEEN(worst[0] / worst[1], 12.0, 24.0);
}

// what is held doesn't creep, not by the last digit in an hour; a millionth more than breakaway moves it
TEST(sticking_is_a_state) {
  for (int moves = 0; moves < 2; moves++) {
    flex_plant *plant = make_plant(&sliders, 1e-6);
    CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
    set_input(plant, 0, B / STIFFNESS * (moves ? 1.000001 : 0.999999));
    advance(plant, 0.0, 1.0, moves ? 1 : 3600);
    CHECK((output(plant, 0) != 0.0) == moves && output(plant, 1) == 0.0 && output(plant, 3) == 0.0);
    if (!moves) CHECK(output(plant, 2) == 0.0 && plant->record->stages.evaluations < 3600 * 20);
    free_plant(plant);
  }
}

// the largest force that friction stands while the pull grows is the breakaway force, wherever steps end
TEST(breakaway_is_met_within_a_step) {
  for (int k = 0; k < 7; k++) {
    flex_plant *plant = make_plant(&sliders, 1e-4);
    plant->p[1] = 1.0 + 0.37 * k;
    begin_pulled(plant, 1.0);

    // it slips for a moment only: z'' = -w^2 z from z = (b - c)/k, z' = 1, y = t - z - c/k
    double t = plant->p[1] / STIFFNESS + 0.01, half = (plant->p[1] - C) / STIFFNESS;
    advance(plant, 0.0, t, 1);
    CHECK_CLOSE(output(plant, 0), t - half * cos(W * 0.01) - sin(W * 0.01) / W - C / STIFFNESS, 1e-9);
    free_plant(plant);
  }
}

// two bodies that catch and drag each other: friction takes what energy is lost, and never more than it can bear
TEST(two_frictions_keep_the_balance) {
  flex_plant *plant = make_plant(&sliders, 1e-8);
  double lost = 0.0, last[2] = {0.0, 0.0};
  int stuck[2] = {0, 0};
  plant->p[3] = 9.0;
  CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
  set_input(plant, 0, 2.0);
  for (int i = 0; i < 40000; i++) {
    advance(plant, 5e-4 * i, 5e-4, 1);
    for (int c = 0; c < 2; c++) {
      double v = output(plant, 2 + c), f = output(plant, 4 + c);
      lost += C * fabs(output(plant, c) - last[c]);
      last[c] = output(plant, c);
      stuck[c] += v == 0.0;
      CHECK(v == 0.0 ? fabs(f) <= B * (1.0 + 1e-9) : fabs(f + copysign(C, v)) < 1e-9);
    }
  }
  CHECK(output(plant, 2) == 0.0 && output(plant, 3) == 0.0 && stuck[0] > 1000 && stuck[1] > 1000);
  double spring = last[0] - 2.0, link = last[1] - last[0];
  CHECK_CLOSE(0.5 * STIFFNESS * 4.0 - lost, 0.5 * STIFFNESS * spring * spring + 4.5 * link * link, 1e-5);
  free_plant(plant);
}

// the same motion again from any state in between, to the last bit, with events on the way and after trial inputs
TEST(friction_rolls_back) {
  flex_plant *plant = make_plant(&sliders, 1e-6);
  plant->p[3] = 3.0;
  begin_pulled(plant, 0.5);
  for (int i = 0; i < 60; i++) advance_twice(plant, 0.1 * i, 0.1, 1);

  // inputs that are tried and taken back let nothing go
  flex_plant *calm = make_plant(&sliders, 1e-6);
  CHECK(flex_plant_begin(calm).outcome == FLEX_DONE);
  set_input(calm, 0, 100.0);
  CHECK(output(calm, 4) == -C);
  set_input(calm, 0, 0.1);
  CHECK_CLOSE(output(calm, 4), -0.4, 1e-15);
  advance(calm, 0.0, 0.1, 10);
  CHECK(output(calm, 0) == 0.0);
  free_plant(plant), free_plant(calm);
}

// a load that trembles about breakaway makes and breaks the contact thousands of times, at a bounded price for each
TEST(chatter_is_bounded) {
  flex_plant *plant = make_plant(&sliders, 1e-6);
  plant->p[1] = C; // the same friction at rest and in motion
  CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
  for (int i = 0; i < 10000; i++) {
    set_input(plant, 0, (C + (i % 2 ? -1e-3 : 1e-3)) / STIFFNESS + output(plant, 0));
    advance(plant, 1e-3 * i, 1e-3, 1);
  }
  CHECK(output(plant, 0) > 0.0 && plant->record->stages.evaluations < 10000 * 120);
  free_plant(plant);
}

// between events outputs are smooth: their rates are those of the closed form, zero for what sticks
TEST(rates_with_friction_are_exact) {
  flex_plant *plant = make_plant(&sliders, 1e-9);
  begin_pulled(plant, 0.3);
  for (int slips = 0; slips < 2; slips++) {
    double v, y, force, a = slips ? 4.0 * (0.3 * 2.0 - output(plant, 0)) - C : 0.0;
    stick_slip(0.3, plant->record->time, &y, &v, &force);
    if (slips) a = 4.0 * (0.3 * plant->record->time - y) - C;
    CHECK(flex_plant_need_rates(plant, 2).outcome == FLEX_DONE);
    CHECK_CLOSE(plant->first_rates[0], v, 1e-8);
    CHECK_CLOSE(plant->first_rates[2], a, 1e-8);
    CHECK_CLOSE(plant->second_rates[2], slips ? 4.0 * (0.3 - v) : 0.0, 1e-8);
    CHECK_CLOSE(plant->first_rates[4], slips ? 0.0 : -4.0 * 0.3, 1e-12);
    advance(plant, 0.0, 2.0, 1 - slips);
  }
  free_plant(plant);
}

/* four carts on top of each other, the first on the ground: unknowns are the displacements relative to what is below, inputs
 * the pulls on the carts, so that each friction relieves or loads all others; d = masses, forces in motion and at rest, directions */
#define CARTS 4

EQUATION(carts_derive) {
  memcpy(res[0], arg[0], 3 * CARTS * sizeof(double));
  memset(res[0] + 3 * CARTS, 0, CARTS * sizeof(double));
  return 0;
}

CONSTANT(carts_zeros, 0.0, 0.0, 0.0, 0.0)
CONSTANT(carts_margin, 1.0)
CONSTANT(carts_scale, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)

// what the frictions have to balance: pulls less inertia of all carts from here on
static void carts_load(const double *a, const double *u, const double *m, double *load) {
  double absolute[CARTS], sum = 0.0;
  for (int k = 0; k < CARTS; k++) absolute[k] = sum += a[k];
  load[CARTS - 1] = u[CARTS - 1] - m[CARTS - 1] * absolute[CARTS - 1];
  for (int k = CARTS - 2; k >= 0; k--) load[k] = load[k + 1] + u[k] - m[k] * absolute[k];
}

EQUATION(carts_residual) {
  const double *d = arg[4];
  carts_load(arg[2], arg[3], d, res[0]);
  for (int k = 0; k < CARTS; k++) res[0][k] = d[3 * CARTS + k] * d[CARTS + k] - res[0][k];
  return 0;
}

EQUATION(carts_mass) {
  for (int i = 0; i < CARTS; i++)
    for (int j = 0; j < CARTS; j++) {
      res[0][i * CARTS + j] = 0.0;
      for (int k = i > j ? i : j; k < CARTS; k++) res[0][i * CARTS + j] += arg[2][k];
    }
  return 0;
}

#define ANY {"any", "1", 1.0, -HUGE_VAL, HUGE_VAL, 1}
static const flex_variable carts_variables[] = {ANY, ANY, ANY, ANY, ANY, ANY, ANY, ANY, ANY, ANY, ANY, ANY};
static const flex_friction carts_frictions[] = {{0, 8, 12}, {1, 9, 13}, {2, 10, 14}, {3, 11, 15}};

static const flex_model carts = {
    .name = "carts", .guid = "{carts}", .n = CARTS, .n_inputs = CARTS, .n_parameters = 3 * CARTS, .n_derived = 4 * CARTS,
    .input_variables = carts_variables, .parameter_variables = carts_variables, .n_frictions = CARTS,
    .frictions = carts_frictions, .default_tolerance = 1e-6, .margin_name = "margin", .derive = FUNCTION(carts_derive),
    .initial_inputs = FUNCTION(carts_zeros), .initial_coordinates = FUNCTION(carts_zeros),
    .residual = FUNCTION(carts_residual), .mass_matrix = FUNCTION(carts_mass), .singularity = FUNCTION(carts_margin),
    .error_scale = FUNCTION(carts_scale)};

static double drawn(unsigned *seed) {
  *seed = *seed * 1664525u + 1013904223u;
  return *seed / 4294967296.0;
}

// carts of drawn masses and frictions with the rates v, under drawn pulls; at rest friction bears so many times more
static flex_plant *pulled_carts(unsigned *seed, const double *v, double more_at_rest) {
  const double zeros[CARTS] = {0.0};
  flex_plant *plant = make_plant(&carts, 1e-6);
  double *m = plant->p, *c = m + CARTS, *b = c + CARTS;
  for (int k = 0; k < CARTS; k++) {
    m[k] = exp(3.0 * drawn(seed) - 1.5);
    c[k] = exp(2.0 * drawn(seed) - 1.0);
    b[k] = more_at_rest * c[k];
  }
  begin_at(plant, zeros, v);
  for (int k = 0; k < CARTS; k++) set_input(plant, k, 6.0 * drawn(seed) - 3.0);
  CHECK(flex_plant_need_acceleration(plant).outcome == FLEX_DONE);
  return plant;
}

// what has the same friction at rest and in motion has one solution (accelerations minimise the convex function
// a' M a / 2 - a' F + sum of c |a|), which its conditions prove: what stays at rest bears at most its largest force, what
// begins to slip is held back by just that, as is what slips already
TEST(coupled_frictions_release_what_must_slip) {
  unsigned seed = 1;
  int counts[CARTS + 1] = {0};
  for (int trial = 0; trial < 3000; trial++) {
    double v[CARTS], load[CARTS];
    for (int k = 0; k < CARTS; k++) v[k] = drawn(&seed) < 0.8 ? 0.0 : drawn(&seed) - 0.5;
    flex_plant *plant = pulled_carts(&seed, v, 1.0);
    const double *a = plant->integrator.a, *c = plant->p + CARTS;
    int released = 0;
    carts_load(a, plant->u, plant->p, load);
    for (int k = 0; k < CARTS; k++) {
      double direction = v[k] != 0.0 ? v[k] : a[k];
      released += v[k] == 0.0 && a[k] != 0.0;
      if (direction == 0.0) CHECK(fabs(load[k]) <= c[k] * (1.0 + 1e-9));
      else CHECK_CLOSE(load[k], copysign(c[k], direction), 1e-9 * c[k]);
    }
    counts[released]++;
    free_plant(plant);
  }
  for (int k = 0; k < CARTS; k++) CHECK(counts[k] > 20);
}

// while a pull grows, what bears the greatest part of its breakaway force lets go first; where that relieves all others enough,
// nothing else does
TEST(the_most_overloaded_friction_lets_go_first) {
  const double zeros[CARTS] = {0.0};
  unsigned seed = 2;
  int others_were_overloaded = 0;
  for (int trial = 0; trial < 3000; trial++) {
    flex_plant *plant = pulled_carts(&seed, zeros, 1.3);
    const double *m = plant->p, *c = m + CARTS, *b = c + CARTS;
    double load[CARTS], a[CARTS] = {0.0}, mass = 0.0;
    int first = 0, overloaded = 0, is_alone = 1;
    carts_load(a, plant->u, m, load);
    for (int k = 0; k < CARTS; k++) {
      overloaded += fabs(load[k]) > b[k];
      if (fabs(load[k]) / b[k] > fabs(load[first]) / b[first]) first = k;
    }
    for (int k = first; k < CARTS; k++) mass += m[k];
    if (overloaded) a[first] = (load[first] - copysign(c[first], load[first])) / mass;
    carts_load(a, plant->u, m, load);
    for (int k = 0; k < CARTS; k++) is_alone &= k == first || fabs(load[k]) <= b[k];
    if (is_alone) {
      others_were_overloaded += overloaded > 1;
      for (int k = 0; k < CARTS; k++) CHECK_CLOSE(plant->integrator.a[k], a[k], 1e-12 * (1.0 + fabs(a[k])));
    }
    free_plant(plant);
  }
  CHECK(others_were_overloaded > 100);
}

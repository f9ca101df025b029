/* Friction that sticks, against the closed forms of stick-slip. */
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
void test_stick_slip_follows_its_closed_form(void) {
  const double tolerances[] = {1e-3, 1e-6, 1e-9}, speed = 0.3;
  for (int method = FLEX_AUTOMATIC; method <= FLEX_LAST_INTEGRATOR; method++)
    for (int k = 0; k < 3; k++) {
      flex_plant *plant = make_plant(&sliders, tolerances[k]);
      double y, v, force, worst = 0.0;
      plant->record->method = method;
      CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
      flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, speed);
      flex_plant_inputs_changed(plant);
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
void test_fixed_steps_end_at_events(void) {
  double worst[2] = {0.0, 0.0};
  for (int k = 0; k < 2; k++) {
    flex_plant *plant = make_plant(&sliders, 1e-6);
    double y, v, force;
    plant->record->method = FLEX_RUNGE_KUTTA_4;
    plant->record->fixed_step = k ? 0.05 : 0.1;
    CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
    flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 0.3);
    flex_plant_inputs_changed(plant);
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
void test_sticking_is_a_state(void) {
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
void test_breakaway_is_met_within_a_step(void) {
  for (int k = 0; k < 7; k++) {
    flex_plant *plant = make_plant(&sliders, 1e-4);
    plant->p[1] = 1.0 + 0.37 * k;
    CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
    flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 1.0);
    flex_plant_inputs_changed(plant);

    // it slips for a moment only: z'' = -w^2 z from z = (b - c)/k, z' = 1, y = t - z - c/k
    double t = plant->p[1] / STIFFNESS + 0.01, half = (plant->p[1] - C) / STIFFNESS;
    advance(plant, 0.0, t, 1);
    CHECK_CLOSE(output(plant, 0), t - half * cos(W * 0.01) - sin(W * 0.01) / W - C / STIFFNESS, 1e-9);
    free_plant(plant);
  }
}

// two bodies that catch and drag each other: friction takes what energy is lost, and never more than it can bear
void test_two_frictions_keep_the_balance(void) {
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
void test_friction_rolls_back(void) {
  flex_plant *plant = make_plant(&sliders, 1e-6);
  char *saved = malloc(plant->state_size), *end = malloc(plant->state_size);
  plant->p[3] = 3.0;
  CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 0.5);
  flex_plant_inputs_changed(plant);
  for (int i = 0; i < 60; i++) {
    memcpy(saved, plant->record, plant->state_size);
    advance(plant, 0.1 * i, 0.1, 1);
    memcpy(end, plant->record, plant->state_size);
    memcpy(plant->record, saved, plant->state_size);
    flex_plant_restored(plant);
    advance(plant, 0.1 * i, 0.1, 1);
    CHECK(memcmp(end, plant->record, plant->state_size) == 0);
  }

  // inputs that are tried and taken back let nothing go
  flex_plant *calm = make_plant(&sliders, 1e-6);
  CHECK(flex_plant_begin(calm).outcome == FLEX_DONE);
  set_input(calm, 0, 100.0);
  CHECK(output(calm, 4) == -C);
  set_input(calm, 0, 0.1);
  CHECK_CLOSE(output(calm, 4), -0.4, 1e-15);
  advance(calm, 0.0, 0.1, 10);
  CHECK(output(calm, 0) == 0.0);
  free(saved), free(end);
  free_plant(plant), free_plant(calm);
}

// a load that trembles about breakaway makes and breaks the contact thousands of times, at a bounded price for each
void test_chatter_is_bounded(void) {
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
void test_rates_with_friction_are_exact(void) {
  flex_plant *plant = make_plant(&sliders, 1e-9);
  CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 0.3);
  flex_plant_inputs_changed(plant);
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

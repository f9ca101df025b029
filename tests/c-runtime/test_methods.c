/* What every integration method promises, whichever the importer chooses. */
#include <string.h>

#include "check.h"
#include "linear_algebra.h"
#include "models.h"
#include "plants.h"
#include "tests.h"
#include "variables.h"

static void choose(flex_plant *plant, int method, double fixed_step) {
  plant->record->method = method;
  plant->record->fixed_step = fixed_step;
}

// end of a motion of two seconds in so many equal steps
static void end_after(const flex_model *model, const double *y, const double *v, int method, int count, double *end) {
  flex_plant *plant = make_plant(model, 1e-13);
  choose(plant, method, 2.0 / count);
  begin_at(plant, y, v);
  advance(plant, 0.0, 2.0, 1);
  CHECK(plant->record->integrator.steps == count);
  memcpy(end, plant->integrator.y, (size_t)model->n * sizeof *end);
  memcpy(end + model->n, plant->integrator.v, (size_t)model->n * sizeof *end);
  free_plant(plant);
}

// slope of the error over the step size between two numbers of steps
static void check_order(const flex_model *model, const double *y, const double *v, int method, int count) {
  double reference[4], coarse = 0.0, fine = 0.0, ends[2][4];
  end_after(model, y, v, FLEX_GAUSS_4, 640, reference);
  for (int k = 0; k < 2; k++) end_after(model, y, v, method, count << k, ends[k]);
  for (int c = 0; c < 2 * model->n; c++) {
    coarse += fabs(ends[0][c] - reference[c]);
    fine += fabs(ends[1][c] - reference[c]);
  }
  int order = flex_find_method(method, 1.0, 0, 0)->order;
  CHECK_BETWEEN(log2(coarse / fine), order - 0.3, order + 0.3);
}

// a method that has lost its order costs time and nobody notices; fixed steps as the importer asks for them
void test_every_method_has_its_order(void) {
  const double y1[1] = {2.0}, v1[1] = {0.5}, y2[2] = {0.6, -0.3}, v2[2] = {0.3, 0.4};
  const int single[] = {0, 0, 8, 8, 6, 16, 64, 64}, twofold[] = {0, 0, 20, 20, 20, 40, 160, 160};
  for (int method = FLEX_GAUSS_2; method <= FLEX_LAST_INTEGRATOR; method++) {
    check_order(&pendulum, y1, v1, method, single[method]);
    check_order(&double_pendulum, y2, v2, method, twofold[method]);
  }
}

// three uncoupled vibrations for a while; returns the error in the energy norm, relative to the energy
static double vibrate(flex_plant *plant, double duration, int count) {
  const double w[3] = {1.0, 2.0, 4.0}, deflection[3] = {1.0, 0.3, 0.1}, rest[3] = {0.0, 0.0, 0.0};
  double error = 0.0, scale = 0.0, y[3];
  memcpy(plant->p, w, sizeof w);

  // the oscillators' coordinates are turned against their modes by a rotation in the first two
  y[0] = 0.6 * deflection[0] - 0.8 * deflection[1], y[1] = 0.8 * deflection[0] + 0.6 * deflection[1], y[2] = deflection[2];
  begin_at(plant, y, rest);
  advance(plant, 0.0, duration / count, count);
  const double *q = plant->integrator.y, *p = plant->integrator.v;
  const double position[3] = {0.6 * q[0] + 0.8 * q[1], -0.8 * q[0] + 0.6 * q[1], q[2]};
  const double rate[3] = {0.6 * p[0] + 0.8 * p[1], -0.8 * p[0] + 0.6 * p[1], p[2]};
  for (int k = 0; k < 3; k++) {
    double dq = w[k] * (position[k] - deflection[k] * cos(w[k] * duration));
    double dp = rate[k] + w[k] * deflection[k] * sin(w[k] * duration);
    error += dq * dq + dp * dp;
    scale += w[k] * w[k] * deflection[k] * deflection[k];
  }
  return sqrt(error / scale);
}

// the tolerance means the same with every method: reached within a factor of ten, and not missed to the good side by more
// than a factor of a hundred, since that is paid for
void test_every_method_meets_the_tolerance(void) {
  for (int method = FLEX_AUTOMATIC; method <= FLEX_LAST_INTEGRATOR; method++)
    for (double tolerance = 1e-3; tolerance > 0.9e-9; tolerance *= 0.1) {
      flex_plant *plant = make_plant(&oscillators, tolerance);
      choose(plant, method, 0.0);
      double error = vibrate(plant, 25.0, 1);
      CHECK_BETWEEN(error, 0.01 * tolerance, 10.0 * tolerance);
      free_plant(plant);
    }
}

// energy that is left of a vibration with many steps too long for it
static double energy_left(int method) {
  const double frequency[3] = {1.0, 1.0, 500.0}, y[3] = {0.0, 0.0, 1.0}, v[3] = {0.0, 0.0, 0.0};
  flex_plant *plant = make_plant(&oscillators, 1e-9);
  memcpy(plant->p, frequency, sizeof frequency);
  choose(plant, method, 0.02);
  begin_at(plant, y, v);
  advance(plant, 0.0, 0.02, 50);
  double q = plant->integrator.y[2], p = plant->integrator.v[2] / 500.0;
  free_plant(plant);
  return q * q + p * p;
}

// what a method does to vibrations that it doesn't resolve is why one chooses Radau or Gauss
void test_radau_damps_and_gauss_does_not(void) {
  CHECK_BETWEEN(energy_left(FLEX_RADAU_3), 0.0, 1e-6);
  for (int method = FLEX_GAUSS_2; method <= FLEX_GAUSS_4; method++) CHECK_CLOSE(energy_left(method), 1.0, 1e-9);
}

// who has left all damping out of a scene wants to see its vibrations go on; everyone else wants the cheapest method
void test_automatic_damps_only_what_is_damped(void) {
  for (double tolerance = 1e-2; tolerance > 0.9e-10; tolerance *= 0.1) {
    CHECK(flex_find_method(FLEX_AUTOMATIC, tolerance, 0, 0)->collocation != &flex_radau_3);
    int is_loose = tolerance > 0.5e-6;
    CHECK((flex_find_method(FLEX_AUTOMATIC, tolerance, 1, 0)->collocation == &flex_radau_3) == is_loose);
    CHECK(flex_find_method(FLEX_AUTOMATIC, tolerance, 1, 1)->collocation == &flex_radau_3);
  }
}

// outputs show accelerations, and their rates come from the mass matrix: both must not be those of a stage before the end
void test_accelerations_belong_to_the_end_of_a_step(void) {
  const double y[2] = {1.0, -0.5}, v[2] = {0.3, 0.8};
  for (int method = FLEX_GAUSS_2; method <= FLEX_LAST_INTEGRATOR; method++) {
    flex_plant *plant = make_plant(&double_pendulum, 1e-9);
    const flex_integrator *g = &plant->integrator;
    choose(plant, method, 0.0);
    begin_at(plant, y, v);
    advance(plant, 0.0, 0.2, 3);
    double residual[2], mass[4];
    CHECK(!flex_residual(&plant->equations, g->y, g->v, g->a, plant->u, residual));
    CHECK(flex_integrator_factor(&plant->integrator, plant->u) == FLEX_DONE);
    CHECK(!flex_mass_matrix(&plant->equations, g->y, plant->u, mass));
    for (int c = 0; c < 2; c++) {
      CHECK_CLOSE(residual[c], 0.0, 1e-7);
      flex_cholesky_solve(2, g->mass_factor, mass + 2 * c);
      for (int i = 0; i < 2; i++) CHECK_CLOSE(mass[2 * c + i], i == c ? 1.0 : 0.0, 1e-12);
    }
    free_plant(plant);
  }
}

// an explicit method with steps too long for a stiff mode must say so instead of putting out nonsense
void test_fixed_steps_that_are_too_long_are_explained(void) {
  for (int method = FLEX_DORMAND_PRINCE; method <= FLEX_RUNGE_KUTTA_4; method++) {
    flex_plant *plant = make_plant(&oscillators, 1e-6);
    const double frequency[3] = {1.0, 1.0, 1e4}, start[3] = {0.0, 0.0, 1e-6}, rest[3] = {0.0, 0.0, 0.0};
    memcpy(plant->p, frequency, sizeof frequency);
    choose(plant, method, 1e-2);
    begin_at(plant, start, rest);
    flex_failure failure = flex_plant_advance(plant, 0.0, 10.0);
    CHECK(failure.outcome == FLEX_STEP_TOO_LONG);
    flex_explain(plant, "integration", &failure);
    CHECK(strstr(plant->message, "fixed step 0.01 s; make integrator.step smaller, or 0 for error control") != NULL);
    for (int c = 0; c < 3; c++) CHECK(isfinite(plant->integrator.y[c]) && isfinite(plant->integrator.v[c]));
    free_plant(plant);
  }
}

// a master that goes back must get the same again, whatever the method keeps from step to step
void test_every_method_rolls_back(void) {
  const double y[2] = {1.0, -0.5}, v[2] = {0.3, 0.8};
  for (int method = FLEX_AUTOMATIC; method <= FLEX_LAST_INTEGRATOR; method++) {
    flex_plant *plant = make_plant(&double_pendulum, 1e-6);
    choose(plant, method, 0.0);
    begin_at(plant, y, v);
    advance(plant, 0.0, 0.1, 7);
    void *kept = malloc(plant->state_size), *first = malloc(plant->state_size);
    memcpy(kept, plant->record, plant->state_size);
    advance(plant, 0.7, 0.3, 3);
    memcpy(first, plant->record, plant->state_size);
    memcpy(plant->record, kept, plant->state_size);
    flex_plant_restored(plant);
    advance(plant, 0.7, 0.3, 3);
    CHECK(memcmp(first, plant->record, plant->state_size) == 0);
    free(kept);
    free(first);
    free_plant(plant);
  }
}

/* The integrator and each of its methods against closed forms and invariants. */
#include <float.h>
#include <string.h>

#include "check.h"
#include "linear_algebra.h"
#include "models.h"
#include "plants.h"
#include "tests.h"
#include "variables.h"

#define TAU 6.283185307179586

/* columns of the rotation between the modes and the coordinates of the oscillators */
static const double modes[3][3] = {{0.6, 0.8, 0.0}, {-0.8, 0.6, 0.0}, {0.0, 0.0, 1.0}};

static double modal(const double *x, int mode) {
  return modes[mode][0] * x[0] + modes[mode][1] * x[1] + modes[mode][2] * x[2];
}

// oscillators with the given frequencies, held at modal deflections and let go
static flex_plant *let_go(const double frequency[3], double damping, const double deflection[3], double tolerance) {
  flex_plant *plant = make_plant(&oscillators, tolerance);
  memcpy(plant->p, frequency, 3 * sizeof(double));
  plant->p[3] = damping;
  for (int i = 0; i < 3; i++)
    set_input(plant, i, modes[0][i] * deflection[0] + modes[1][i] * deflection[1] + modes[2][i] * deflection[2]);
  begin_static(plant);
  for (int i = 0; i < 3; i++) set_input(plant, i, 0.0);
  return plant;
}

static void choose(flex_plant *plant, int method, double fixed_step) {
  plant->record->method = method;
  plant->record->fixed_step = fixed_step;
  flex_plant_restored(plant);
}

// deflection and rate of a mode that was let go at t = 0
static void free_vibration(double w, double zeta, double deflection, double t, double *q, double *p) {
  double wd = w * sqrt(1.0 - zeta * zeta), decay = deflection * exp(-zeta * w * t);
  *q = decay * (cos(wd * t) + zeta * w / wd * sin(wd * t));
  *p = -decay * w * w / wd * sin(wd * t);
}

// error in the energy norm, relative to the energy at the start
static double vibration_error(const flex_plant *plant, const double deflection[3]) {
  double error = 0.0, scale = 0.0;
  for (int k = 0; k < 3; k++) {
    double w = plant->p[k], q, p;
    free_vibration(w, plant->p[3], deflection[k], plant->record->time, &q, &p);
    double dq = w * (modal(plant->integrator.y, k) - q), dp = modal(plant->integrator.v, k) - p;
    error += dq * dq + dp * dp;
    scale += w * w * deflection[k] * deflection[k];
  }
  return sqrt(error / scale);
}

// the tolerance holds whatever the communication step, which must not cost more than its own solution each
TEST(tolerance_is_achieved_between_short_steps) {
  const double frequency[3] = {1.0, 2.0, 3.0}, deflection[3] = {1.0, 0.3, 0.1};
  for (double tolerance = 1e-3; tolerance > 0.9e-9; tolerance *= 0.1)
    for (int count = 10; count <= 10000; count *= 10) {
      flex_plant *plant = let_go(frequency, 0.0, deflection, tolerance);
      advance(plant, 0.0, 3.0 * TAU / count, count);
      CHECK_BETWEEN(vibration_error(plant, deflection), 0.0, 10.0 * tolerance);
      if (count == 10000) CHECK(plant->record->stages.iterations < 1.3 * count);
      free_plant(plant);
    }
}

// an A-stable method does not see a mode a million times faster that isn't excited
TEST(stiff_modes_at_rest_cost_nothing) {
  const double soft[3] = {1.0, 3.0, 5.0}, stiff[3] = {1.0, 3.0, 1e6}, deflection[3] = {1.0, 0.2, 0.0};
  for (double tolerance = 1e-3; tolerance > 0.9e-7; tolerance *= 0.1)
    for (double damping = 0.0; damping < 0.3; damping += 0.2) {
      flex_plant *plain = let_go(soft, damping, deflection, tolerance),
                 *plant = let_go(stiff, damping, deflection, tolerance);
      advance(plain, 0.0, TAU, 3);
      advance(plant, 0.0, TAU, 3);
      CHECK(plant->record->integrator.steps <= 2 * plain->record->integrator.steps + 10);
      CHECK_BETWEEN(vibration_error(plant, deflection), 0.0, 10.0 * tolerance);
      free_plant(plain);
      free_plant(plant);
    }
}

// a fast mode that does carry energy is part of the solution and has to be right
TEST(stiff_modes_in_motion_are_resolved) {
  const double frequency[3] = {1.0, 3.0, 1e3}, deflection[3] = {1.0, 0.2, 1e-4};
  flex_plant *plant = let_go(frequency, 0.05, deflection, 1e-5);
  advance(plant, 0.0, 1e-3, 50);
  CHECK_BETWEEN(vibration_error(plant, deflection), 0.0, 1e-4);
  free_plant(plant);
}

// motion that takes far more work than its length admits ends, with a sentence, and soon again when the step is repeated
TEST(work_without_end_is_told) {
  const double frequency[3] = {1.0, 3.0, 1e8}, y[3] = {0.0, 0.0, 1.0}, v[3] = {0.0, 0.0, 0.0};
  flex_plant *plant = make_plant(&oscillators, 1e-6);
  memcpy(plant->p, frequency, sizeof frequency);
  begin_at(plant, y, v);
  flex_failure failure = flex_plant_advance(plant, 0.0, 1e-3);
  CHECK(failure.outcome == FLEX_TOO_MUCH_WORK && failure.time < 1e-3);
  long long evaluations = plant->record->stages.evaluations;
  CHECK_BETWEEN((double)evaluations, 1.0e6, 1.1e6);
  flex_explain(plant, "integration", failure);
  CHECK(strstr(plant->message, "more than 4e+07 times per second of motion") && strstr(plant->message, "larger tolerance"));
  CHECK(flex_plant_advance(plant, failure.time, failure.time + 1e-3).outcome == FLEX_TOO_MUCH_WORK);
  CHECK_BETWEEN((double)(plant->record->stages.evaluations - evaluations), 0.0, 1e5);
  free_plant(plant);
}

// input derivatives carry a polynomial over the step: its response is a polynomial, which collocation gives exactly
TEST(forced_motion_is_exact) {
  const double w = 2.0;
  flex_plant *plant = make_plant(&oscillators, 1e-9);
  for (int k = 0; k < 3; k++) plant->p[k] = w;

  // q = t^3 solves q'' + w^2 q = w^2 u with u = t^3 + 6 t / w^2, mode for mode
  const double zero[3] = {0.0, 0.0, 0.0};
  begin_at(plant, zero, zero);
  set_input(plant, 0, 0.0);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 6.0 / (w * w));
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 3, 6.0);
  advance(plant, 0.0, 0.25, 8);
  CHECK_CLOSE(plant->integrator.y[0], 8.0, 1e-12);
  CHECK_CLOSE(plant->integrator.v[0], 12.0, 1e-12);
  CHECK_CLOSE(plant->integrator.a[0], 12.0, 1e-12);
  free_plant(plant);
}

// loads that jump every `pieces` communication steps, against the closed form; returns the steps of the integrator
static long long meet_jumps(int method, double tolerance, int pieces) {
  const double frequency[3] = {1.0, 3.0, 7.0}, nothing[3] = {0.0, 0.0, 0.0};
  flex_plant *plant = let_go(frequency, 0.0, nothing, tolerance);
  double q[3] = {0.0}, p[3] = {0.0};
  choose(plant, method, 0.0);
  for (int k = 0; k < 40; k++) {
    double load = k % 3 - 1.0, h = 0.4;
    for (int i = 0; i < 3; i++) set_input(plant, i, load * modes[0][i] + 0.5 * load * modes[2][i]);
    advance(plant, k * h, h / pieces, pieces);

    // closed form over the step: vibration about the new equilibrium
    const double rest[3] = {load, 0.0, 0.5 * load};
    for (int m = 0; m < 3; m++) {
      double w = frequency[m], c = cos(w * h), s = sin(w * h), x = q[m] - rest[m];
      q[m] = rest[m] + x * c + p[m] / w * s;
      p[m] = -x * w * s + p[m] * c;
    }
  }
  for (int m = 0; m < 3; m++) CHECK_CLOSE(modal(plant->integrator.y, m), q[m], 20.0 * tolerance);
  long long steps = plant->record->integrator.steps;
  free_plant(plant);
  return steps;
}

// an input that jumps between steps starts a new motion: nothing of the old one may be extrapolated into it, nor may a step that has
// gone beyond the jump, and of which the motion up to it is interpolated
TEST(jumps_of_the_input_are_met) {
  for (double tolerance = 1e-4; tolerance > 0.9e-10; tolerance *= 0.01) {
    meet_jumps(FLEX_AUTOMATIC, tolerance, 1);
    meet_jumps(FLEX_RADAU_3_DENSE, tolerance, 1);
    meet_jumps(FLEX_RADAU_3_DENSE, tolerance, 64);
  }
  CHECK(2 * meet_jumps(FLEX_RADAU_3_DENSE, 1e-4, 64) < meet_jumps(FLEX_RADAU_3, 1e-4, 64));
}

// interpolated points are as good as ends of steps, and a quarter of the steps is enough where these are far shorter than the error asks
TEST(communication_points_are_interpolated) {
  const double deflection[3] = {1.0, 0.3, 0.1}, tolerance = 1e-5;
  flex_plant *plant = let_go((const double[]){1.0, 2.0, 4.0}, 0.0, deflection, tolerance);
  choose(plant, FLEX_RADAU_3_DENSE, 0.0);
  for (int k = 0; k < 5000; k++) {
    advance(plant, 0.005 * k, 0.005, 1);
    CHECK(vibration_error(plant, deflection) < tolerance);
  }
  CHECK_BETWEEN((double)plant->record->integrator.steps, 200.0, 1300.0);
  free_plant(plant);
}

// at communication points polynomials begin where others have ended, but for roundings: those call for no new acceleration
TEST(inputs_that_go_on_cost_nothing) {
  flex_plant *plant = let_go((const double[]){1.0, 3.0, 7.0}, 0.0, (const double[]){0.0, 0.0, 0.0}, 1e-6);
  set_input(plant, 0, 0.1);
  advance(plant, 0.0, 0.1, 1);
  long long before = plant->record->stages.evaluations;
  set_input(plant, 0, 0.1 * (1.0 + 4.0 * DBL_EPSILON));
  CHECK(flex_plant_need_acceleration(plant).outcome == FLEX_DONE);
  CHECK(plant->record->stages.evaluations == before);
  set_input(plant, 0, 0.1 * (1.0 + 1e-12));
  CHECK(flex_plant_need_acceleration(plant).outcome == FLEX_DONE);
  CHECK(plant->record->stages.evaluations == before + 1);
  free_plant(plant);
}

// sum over modes of the error in the energy norm
static double driven_error(const flex_plant *plant, const double *q, const double *p) {
  double error = 0.0;
  for (int k = 0; k < 3; k++) error = fmax(error, hypot(plant->p[k] * (plant->integrator.y[k] - q[k]), plant->integrator.v[k] - p[k]));
  return error;
}

// a slow motion teaches that cheap estimates are far too pessimistic; the vibration after a jerk must not be judged by that
TEST(jerks_are_noticed) {
  const double slow = 20.0, amplitude = 1.0, jerk = 1e5, h = 5e-3;
  for (double tolerance = 1e-6; tolerance > 0.9e-10; tolerance *= 0.1) {
    flex_plant *plant = make_plant(&oscillators, tolerance);
    const double w[3] = {200.0, 200.0, 900.0};
    double y[3] = {0.0, 0.0, 0.0}, v[3], q[3], p[3], scale = 0.0, worst = 0.0;
    memcpy(plant->p, w, sizeof w);

    // forced by amplitude sin(slow t) in all coordinates, from the start on without a free vibration
    for (int k = 0; k < 3; k++) {
      v[k] = amplitude * slow * w[k] * w[k] / (w[k] * w[k] - slow * slow);
      scale = fmax(scale, w[k] * amplitude);
    }
    begin_at(plant, y, v);
    for (int step = 0; step < 60; step++) {
      double t = step * h, since = t - 0.15;
      for (int k = 0; k < 3; k++) {
        set_input(plant, k, amplitude * sin(slow * t) + (since >= 0.0 ? jerk * since * since * since / 6.0 : 0.0));
        for (int order = 1; order < 10; order++) {
          double derivative = amplitude * pow(slow, order) * sin(slow * t + order * TAU / 4.0);
          if (since >= 0.0 && order <= 3) derivative += jerk * pow(since, 3 - order) / (order == 1 ? 2.0 : 1.0);
          flex_inputs_set_derivative(&plant->inputs, k, t, order, derivative);
        }
      }
      advance(plant, t, h, 1);

      // closed form at the end of the step
      since += h;
      for (int k = 0; k < 3; k++) {
        q[k] = v[k] / slow * sin(slow * (t + h));
        p[k] = v[k] * cos(slow * (t + h));
        if (since > 0.0) {
          q[k] += jerk * (since * since * since / 6.0 - since / (w[k] * w[k]) + sin(w[k] * since) / pow(w[k], 3));
          p[k] += jerk * (since * since / 2.0 - 1.0 / (w[k] * w[k]) + cos(w[k] * since) / (w[k] * w[k]));
        }
      }
      worst = fmax(worst, driven_error(plant, q, p) / scale);
    }
    CHECK_BETWEEN(worst, 0.0, 10.0 * tolerance);
    free_plant(plant);
  }
}

static double oscillator_energy(const flex_plant *plant) {
  double energy = 0.0;
  for (int k = 0; k < 3; k++) {
    double q = modal(plant->integrator.y, k), p = modal(plant->integrator.v, k);
    energy += 0.5 * (plant->p[k] * plant->p[k] * q * q + p * p);
  }
  return energy;
}

// Gauss methods keep quadratic invariants if the stages are solved and summed well enough: no damping of their own
TEST(energy_stays_over_many_steps) {
  const double deflection[3] = {1.0, 0.3, 1e-3};
  const double frequency[2][3] = {{1.0, 3.0, 7.0}, {1.0, 3.0, 2e3}};
  const double tolerances[3] = {1e-5, 1e-8, 1e-11};
  for (int f = 0; f < 2; f++)
    for (int t = 0; t < 3; t++) {
      if (f == 1 && t == 2) continue; // would resolve 2000 rad/s to eleven digits
      flex_plant *plant = let_go(frequency[f], 0.0, deflection, tolerances[t]);
      double start = oscillator_energy(plant);
      advance(plant, 0.0, f == 0 ? 0.02 : 1e-4, 100000);
      CHECK_CLOSE(oscillator_energy(plant) / start, 1.0, 1e-9);
      free_plant(plant);
    }
}

// nonlinear motion keeps its energy to the accuracy of the method, without drift; a mass matrix that changes makes a kept
// iteration matrix worse from step to step, which must not go unnoticed
TEST(energy_stays_in_nonlinear_motion) {
  const double y1[1] = {2.5}, v1[1] = {0.0}, y2[2] = {1.0, -0.5}, v2[2] = {0.3, 0.8};
  flex_plant *single = make_plant(&pendulum, 1e-10), *twofold = make_plant(&double_pendulum, 1e-10);
  begin_at(single, y1, v1);
  begin_at(twofold, y2, v2);
  double single_start = output(single, 0), twofold_start = output(twofold, 0);
  advance(single, 0.0, 0.02, 100000);
  advance(twofold, 0.0, 0.01, 20000);
  CHECK_CLOSE(output(single, 0), single_start, 1e-11);
  CHECK_CLOSE(output(twofold, 0), twofold_start, 1e-11);
  free_plant(single);
  free_plant(twofold);
}

// communication steps of any size: the time they take is theirs, the result is the motion's
TEST(step_sizes_from_nanoseconds_to_seconds) {
  const double frequency[3] = {100.0, 360.0, 1e4}, deflection[3] = {1.0, 0.1, 0.0};
  const double sizes[] = {1e-9, 1e-7, 1e-5, 1e-3, 0.1, 1.0};
  for (int k = 0; k < 6; k++) {
    flex_plant *plant = let_go(frequency, 0.02, deflection, 1e-6);
    advance(plant, 0.0, sizes[k], k < 3 ? 1000 : 3);
    CHECK_BETWEEN(vibration_error(plant, deflection), 0.0, 1e-5);
    free_plant(plant);
  }
}

// nothing moves without a cause: rounding errors must not be mistaken for a motion
TEST(rest_stays_at_rest) {
  const double frequency[3] = {1.0, 30.0, 1e5}, load[3] = {1.0, 1e-3, 1e-6};
  flex_plant *plant = make_plant(&oscillators, 1e-10);
  memcpy(plant->p, frequency, sizeof frequency);
  for (int i = 0; i < 3; i++) set_input(plant, i, load[i]);
  begin_static(plant);
  advance(plant, 0.0, 0.1, 100);
  for (int i = 0; i < 3; i++) CHECK_CLOSE(plant->integrator.y[i], load[i], 1e-13);
  CHECK(plant->record->integrator.steps < 2000);
  free_plant(plant);
}

/* what every integration method promises, whichever the importer chooses */

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
TEST(every_method_has_its_order) {
  const double y1[1] = {2.0}, v1[1] = {0.5}, y2[2] = {0.6, -0.3}, v2[2] = {0.3, 0.4};
  const int single[] = {0, 0, 8, 8, 6, 16, 64, 64, 16}, twofold[] = {0, 0, 20, 20, 20, 40, 160, 160, 40};
  for (int method = FLEX_GAUSS_2; method <= FLEX_LAST_INTEGRATOR; method++) {
    check_order(&pendulum, y1, v1, method, single[method]);
    check_order(&double_pendulum, y2, v2, method, twofold[method]);
  }
}

// the tolerance means the same with every method: reached within a factor of ten, and not missed to the good side by more
// than a factor of a hundred, since that is paid for
TEST(every_method_meets_the_tolerance) {
  const double deflection[3] = {1.0, 0.3, 0.1};
  for (int method = FLEX_AUTOMATIC; method <= FLEX_LAST_INTEGRATOR; method++)
    for (double tolerance = 1e-3; tolerance > (method ? 0.9e-9 : 0.9e-11); tolerance *= 0.1) {
      flex_plant *plant = let_go((const double[]){1.0, 2.0, 4.0}, 0.0, deflection, tolerance);
      choose(plant, method, 0.0);
      advance(plant, 0.0, 25.0, 1);
      CHECK_BETWEEN(vibration_error(plant, deflection), 0.01 * tolerance, 10.0 * tolerance);
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
TEST(radau_damps_and_gauss_does_not) {
  CHECK_BETWEEN(energy_left(FLEX_RADAU_3), 0.0, 1e-6);
  for (int method = FLEX_GAUSS_2; method <= FLEX_GAUSS_4; method++) CHECK_CLOSE(energy_left(method), 1.0, 1e-9);
}

// who has left all damping out of a scene wants to see its vibrations go on; everyone else wants the cheapest method
TEST(automatic_damps_only_what_is_damped) {
  for (double tolerance = 1e-2; tolerance > 0.9e-10; tolerance *= 0.1) {
    CHECK(flex_find_method(FLEX_AUTOMATIC, tolerance, 0, 0)->collocation != &flex_radau_3);
    int is_loose = tolerance > 0.5e-6;
    CHECK((flex_find_method(FLEX_AUTOMATIC, tolerance, 1, 0)->collocation == &flex_radau_3) == is_loose);
    CHECK(flex_find_method(FLEX_AUTOMATIC, tolerance, 1, 1)->collocation == &flex_radau_3);
  }
}

// outputs show accelerations, and their rates come from the mass matrix: both must not be those of a stage before the end
TEST(accelerations_belong_to_the_end_of_a_step) {
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
TEST(fixed_steps_that_are_too_long_are_explained) {
  for (int method = FLEX_DORMAND_PRINCE; method <= FLEX_RUNGE_KUTTA_4; method++) {
    flex_plant *plant = make_plant(&oscillators, 1e-6);
    const double frequency[3] = {1.0, 1.0, 1e4}, start[3] = {0.0, 0.0, 1e-6}, rest[3] = {0.0, 0.0, 0.0};
    memcpy(plant->p, frequency, sizeof frequency);
    choose(plant, method, 1e-2);
    begin_at(plant, start, rest);
    flex_failure failure = flex_plant_advance(plant, 0.0, 10.0);
    CHECK(failure.outcome == FLEX_STEP_TOO_LONG);
    flex_explain(plant, "integration", failure);
    CHECK(strstr(plant->message, "fixed step 0.01 s; make integrator.step smaller, or 0 for error control") != NULL);
    for (int c = 0; c < 3; c++) CHECK(isfinite(plant->integrator.y[c]) && isfinite(plant->integrator.v[c]));
    free_plant(plant);
  }
}

// a master that goes back must get the same again, whatever the method keeps from step to step
TEST(every_method_rolls_back) {
  const double y[2] = {1.0, -0.5}, v[2] = {0.3, 0.8};
  for (int method = FLEX_AUTOMATIC; method <= FLEX_LAST_INTEGRATOR; method++) {
    flex_plant *plant = make_plant(&double_pendulum, 1e-6);
    choose(plant, method, 0.0);
    begin_at(plant, y, v);
    advance(plant, 0.0, 0.1, 7);
    advance_twice(plant, 0.7, 0.3, 3);
    free_plant(plant);
  }
}

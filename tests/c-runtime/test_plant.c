/* The plant: start, outputs with their rates, parameters. */
#pragma GCC diagnostic ignored "-Wunused-parameter" // functions of models have CasADi's signature
#include <string.h>

#include "check.h"
#include "models.h"
#include "plants.h"
#include "tests.h"
#include "variables.h"

// the motion starts where gravity and loads leave the structure, so that it does not ring from the first moment on
TEST(static_equilibrium_is_found) {
  for (double torque = -0.99; torque < 1.0; torque += 0.33) {
    flex_plant *plant = make_plant(&pendulum, 1e-6);
    set_input(plant, 0, torque);
    begin_static(plant);
    CHECK_CLOSE(plant->integrator.y[0], asin(torque), 1e-13);
    CHECK(plant->integrator.v[0] == 0.0);
    output(plant, 0);
    CHECK_CLOSE(plant->integrator.a[0], 0.0, 1e-14);
    free_plant(plant);
  }
}

// a torque that no deflection can balance is an answer, not an endless search
TEST(static_equilibrium_may_be_missing) {
  flex_plant *plant = make_plant(&pendulum, 1e-6);
  set_input(plant, 0, 1.5);
  flex_failure failure = flex_plant_begin(plant);
  CHECK(failure.outcome == FLEX_NO_EQUILIBRIUM);
  flex_explain(plant, "initialisation", failure);
  CHECK(strstr(plant->message, "initial = 2") != NULL);

  // the instance is still usable
  plant->record->starts_static = 0;
  flex_plant_start_changed(plant);
  CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
  output(plant, 0);
  CHECK_CLOSE(plant->integrator.a[0], 1.5, 1e-15);
  free_plant(plant);
}

// metrics interpolate outputs by their derivatives: both must be exact, also right after an input has changed
TEST(rates_of_outputs_are_exact) {
  flex_plant *plant = make_plant(&oscillators, 1e-12);
  const double y[3] = {0.3, -0.2, 0.1}, v[3] = {1.0, 0.5, -2.0};
  plant->p[3] = 0.1;
  begin_at(plant, y, v);
  set_input(plant, 0, 0.7);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 2.0);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 2, -3.0);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 3, 5.0);
  advance(plant, 0.0, 0.3, 1);
  CHECK(flex_plant_need_rates(plant, 2).outcome == FLEX_DONE);
  double first[9], second[9], before[9], after[9];
  memcpy(first, plant->first_rates, sizeof first);
  memcpy(second, plant->second_rates, sizeof second);

  // against differences over a small time, of values and of first rates
  double h = 1e-4;
  for (int i = 0; i < 9; i++) before[i] = output(plant, i);
  advance(plant, 0.3, h, 1);
  for (int i = 0; i < 9; i++) after[i] = output(plant, i);
  CHECK(flex_plant_need_rates(plant, 2).outcome == FLEX_DONE);
  for (int i = 0; i < 9; i++) {
    double mean = 0.5 * (first[i] + plant->first_rates[i]) + h * (second[i] - plant->second_rates[i]) / 12.0;
    CHECK_CLOSE((after[i] - before[i]) / h, mean, 1e-8);
    CHECK_CLOSE((plant->first_rates[i] - first[i]) / h, 0.5 * (second[i] + plant->second_rates[i]), 1e-4);
  }

  // a new first derivative of the input changes the rates of accelerations and nothing else
  flex_inputs_set_derivative(&plant->inputs, 0, plant->record->time, 1, 100.0);
  flex_plant_inputs_changed(plant);
  CHECK(flex_plant_need_rates(plant, 1).outcome == FLEX_DONE);
  CHECK(output(plant, 6) == after[6]);
  CHECK(fabs(plant->first_rates[6] - first[6]) > 1.0);
  free_plant(plant);
}

// a scene without elastic links is a valid scene
TEST(rigid_models_follow_their_inputs) {
  flex_plant *plant = make_plant(&rigid, 1e-6);
  set_input(plant, 0, -3.0);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 2.0);
  begin_static(plant);
  CHECK(output(plant, 0) == 9.0);
  advance(plant, 0.0, 0.5, 2);
  CHECK_CLOSE(output(plant, 0), 1.0, 1e-15);
  CHECK(flex_plant_need_rates(plant, 2).outcome == FLEX_DONE);
  CHECK_CLOSE(plant->first_rates[0], 2.0 * -1.0 * 2.0, 1e-14);
  CHECK_CLOSE(plant->second_rates[0], 2.0 * 2.0 * 2.0, 1e-14);

  // 1 - u >= 0 ends at t = 2
  flex_failure failure = flex_plant_advance(plant, 1.0, 3.5);
  CHECK(failure.outcome == FLEX_TOO_SINGULAR && failure.time == 1.0);
  CHECK_CLOSE(failure.value, -3.0, 1e-14);
  CHECK_CLOSE(output(plant, 0), 1.0, 1e-15);
  free_plant(plant);
}

// a tunable parameter acts from the communication point on, a fixed one is refused
TEST(parameters_may_be_tuned) {
  flex_plant *plant = make_plant(&fragile, 1e-9);
  begin_static(plant);
  advance(plant, 0.0, 0.5, 2);
  CHECK_CLOSE(output(plant, 0), 0.0, 1e-15);
  CHECK(flex_set_real(plant, 2, 0.5) == 0);
  CHECK(flex_set_real(plant, 1, 3.0) == 1);
  CHECK(strstr(plant->message, "limit is fixed") != NULL);
  advance(plant, 1.0, 0.25, 8);
  CHECK_CLOSE(output(plant, 0), 0.5 * (1.0 - cos(2.0)), 1e-8);
  free_plant(plant);
}

CONSTANT(negative_mass, -1.0)
CONSTANT(no_floor, 1.0, 1.0, 0.0)
CONSTANT(nan_result, NAN)

EQUATION(refusal) {
  return 1;
}

// M = 1 says the mass matrix, but the residual has M = 4: Newton's corrections grow threefold at any step size
FORMULA(false_mass, 4.0 * arg[2][0] - 1.0)

// y'' = 6 y^2, solved by 1/(1 - t)^2
FORMULA(blow_up, arg[2][0] - 6.0 * arg[0][0] * arg[0][0])

// y'' = force, but only up to 50 N
FORMULA(picky, arg[3][0] > 50.0 ? NAN : arg[2][0] - arg[3][0])

// a start that fails gives the outcome and a sentence with this part
static void check_start(const flex_model *model, flex_outcome outcome, const char *part) {
  flex_plant *plant = make_plant(model, 1e-6);
  flex_failure failure = flex_plant_begin(plant);
  CHECK(failure.outcome == outcome && !plant->record->is_moving);
  flex_explain(plant, "initialisation", failure);
  CHECK(strncmp(plant->message, "initialisation: ", 16) == 0 && strstr(plant->message, part) != NULL);
  double value;
  CHECK(flex_get_real(plant, 3, &value) == 1 && strstr(plant->message, part) != NULL);
  free_plant(plant);
}

// whatever a model does wrong has its own sentence, and reading outputs says the same instead of giving numbers
TEST(failures_are_explained) {
  flex_model model = fragile;
  model.mass_matrix.call = negative_mass;
  check_start(&model, FLEX_NOT_DEFINITE, "mass matrix is not positive definite");
  model = fragile;
  model.error_scale.call = no_floor;
  check_start(&model, FLEX_BAD_SCALE, "unusable error norm");
  model = fragile;
  model.minimum_margin = 3.0;
  check_start(&model, FLEX_TOO_SINGULAR, "distance between the elbows (m) is 2, but must be at least 3");
  const flex_function fragile_parts[] = {FUNCTION(refusal), FUNCTION(nan_result)};
  for (int k = 0; k < 2; k++) {
    flex_function *const parts[] = {&model.derive, &model.initial_inputs, &model.residual, &model.mass_matrix};
    for (int i = 0; i < 4; i++) {
      model = fragile;
      *parts[i] = fragile_parts[k];
      check_start(&model, FLEX_NOT_FINITE, "no finite number");
    }
  }

  // outputs and rates alone may be undefined while the motion is not
  for (int k = 0; k < 2; k++) {
    model = fragile;
    model.outputs = model.motion_rate1 = model.motion_rate2 = fragile_parts[k];
    flex_plant *plant = make_plant(&model, 1e-6);
    double value;
    begin_static(plant);
    advance(plant, 0.0, 0.1, 1);
    CHECK(flex_get_real(plant, 3, &value) == 1 && strstr(plant->message, "computing outputs") != NULL);
    CHECK(flex_get_output_derivative(plant, 3, 1, &value) == 1);
    CHECK(flex_get_output_derivative(plant, 3, 2, &value) == 1 && strstr(plant->message, "output derivatives") != NULL);
    free_plant(plant);
  }
}

// equations that no step size makes solvable end the search, with the plant as it was
TEST(unsolvable_equations_are_given_up) {
  flex_model model = fragile;
  model.residual.call = false_mass;
  flex_plant *plant = make_plant(&model, 1e-6);
  plant->record->starts_static = 0;
  CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
  plant->integrator.a[0] = 10.0;
  flex_failure failure = flex_plant_advance(plant, 0.0, 1.0);
  CHECK(failure.outcome == FLEX_NO_CONVERGENCE && failure.time == 0.0);
  flex_explain(plant, "integration", failure);
  CHECK(strstr(plant->message, "cannot be solved") != NULL);
  CHECK(plant->integrator.y[0] == 0.0 && plant->integrator.v[0] == 0.0 && plant->integrator.a[0] == 10.0);
  free_plant(plant);
}

// a solution that ends has to be followed to its end and left there, finite
TEST(blow_up_is_reported) {
  flex_model model = fragile;
  model.residual.call = blow_up;
  for (double tolerance = 1e-3; tolerance > 0.9e-9; tolerance *= 1e-3) {
    flex_plant *plant = make_plant(&model, tolerance);
    const double y[1] = {1.0}, v[1] = {2.0};
    begin_at(plant, y, v);
    flex_failure failure = flex_plant_advance(plant, 0.0, 2.0);
    CHECK(failure.outcome != FLEX_DONE && plant->record->time == failure.time);
    CHECK_CLOSE(failure.time, 1.0, 0.1);
    CHECK(isfinite(plant->integrator.y[0]) && isfinite(plant->integrator.v[0]) && isfinite(plant->integrator.a[0]));
    flex_explain(plant, "integration", failure);
    CHECK(strlen(plant->message) > 40);
    free_plant(plant);
  }
}

// the energy of a pendulum under torque changes by its power: rates of a nonlinear model
TEST(rates_follow_the_power) {
  flex_plant *plant = make_plant(&pendulum, 1e-11);
  const double y[1] = {0.4}, v[1] = {1.5};
  begin_at(plant, y, v);
  set_input(plant, 0, 0.3);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, 0.7);
  advance(plant, 0.0, 0.2, 3);
  CHECK(flex_plant_need_rates(plant, 2).outcome == FLEX_DONE);
  double torque = 0.3 + 0.7 * 0.6;
  CHECK_CLOSE(plant->first_rates[0], torque * plant->integrator.v[0], 1e-14);
  CHECK_CLOSE(plant->second_rates[0], 0.7 * plant->integrator.v[0] + torque * plant->integrator.a[0], 1e-14);
  free_plant(plant);
}

// an input that the model cannot bear gives an error, and the next one that it can gives the motion again
TEST(bad_inputs_leave_no_trace) {
  flex_model model = fragile;
  model.residual.call = picky;
  flex_plant *plant = make_plant(&model, 1e-6);
  const double zero[1] = {0.0};
  double value;
  begin_at(plant, zero, zero);
  set_input(plant, 0, 1.0);
  advance(plant, 0.0, 0.5, 2);
  set_input(plant, 0, 60.0);
  CHECK(flex_get_real(plant, 3, &value) == 1);
  CHECK(flex_plant_advance(plant, 1.0, 2.0).outcome == FLEX_NOT_FINITE);
  set_input(plant, 0, 1.0);
  CHECK(flex_get_real(plant, 3, &value) == 0);
  advance(plant, 1.0, 0.5, 2);
  CHECK_CLOSE(output(plant, 0), 2.0, 1e-12);
  free_plant(plant);
}

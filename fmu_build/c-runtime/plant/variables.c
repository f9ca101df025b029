#include "variables.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#define refuse(plant, ...) flex_refuse((plant)->message, __VA_ARGS__)

// appends to the message where the mechanism was last; its outputs borrow the memory of their rates
static void add_pose(flex_plant *plant) {
  const flex_model *model = plant->model;
  const flex_integrator *g = &plant->integrator;
  const double *const arguments[] = {g->y, g->v, g->a, plant->u, plant->d};
  if (model->n_pose == 0) return;
  plant->record->have &= ~FLEX_HAVE_FIRST_RATES;
  if (flex_call(&plant->equations, &model->outputs, 5, arguments, plant->first_rates)) return;
  for (int i = 0; i < model->n_pose; i++) {
    const flex_variable *variable = &model->output_variables[model->pose_outputs[i]];
    double place = plant->first_rates[model->pose_outputs[i]];
    size_t length = strlen(plant->message);
    if (!isfinite(place)) return;
    snprintf(plant->message + length, FLEX_MESSAGE_SIZE - length, "%s %s = %.6g %s", i ? "," : "; it was last at",
             variable->name, place, variable->unit);
  }
}

// an input of this size is the likely cause of numbers that overflow: beyond any position, speed, force or acceleration in SI units
#define SUSPICIOUS 1e6

// appends the largest input at an instant if it is suspicious; 0 if none is
static int add_largest_input(flex_plant *plant, double t) {
  const flex_model *model = plant->model;
  double *u = plant->integrator.end_u, largest = 0.0;
  int place = -1;
  flex_inputs_evaluate(&plant->inputs, t, 0.0, u);
  for (int i = 0; i < model->n_inputs; i++) {
    if (!(fabs(u[i]) > largest)) continue;
    largest = fabs(u[i]);
    place = i;
  }
  if (!(largest >= SUSPICIOUS)) return 0;
  const flex_variable *variable = &model->input_variables[place];
  size_t length = strlen(plant->message);
  snprintf(plant->message + length, FLEX_MESSAGE_SIZE - length, "; check the inputs, of which %s = %.6g %s is the largest",
           variable->name, u[place], variable->unit);
  return 1;
}

int flex_explain(flex_plant *plant, const char *what, flex_failure failure) {
  const flex_model *model = plant->model;
  double t = failure.time, value = failure.value;
  switch (failure.outcome) {
    case FLEX_DONE: return 0;
    case FLEX_INACCURATE:
      refuse(plant,
             "%s: at %.9g s no step size meets the relative tolerance %.3g, the error stays at %.3g; loosen the tolerance",
             what, t, plant->record->tolerance, value);
      break;
    case FLEX_NO_CONVERGENCE:
      refuse(plant, "%s: at %.9g s the equations of motion cannot be solved for any step size", what, t);
      if (add_largest_input(plant, t)) break;
      refuse(plant, "%s: at %.9g s the equations of motion cannot be solved for any step size; check inputs and parameters",
             what, t);
      break;
    case FLEX_NOT_FINITE:
      refuse(plant, "%s: at %.9g s the model gives no finite number", what, t);
      if (add_largest_input(plant, t)) break;
      if (model->iterated)
        refuse(plant, "%s: at %.9g s the iteration of the constraints for %s fails, or the equations give no finite number", what,
               t, model->iterated);
      else
        refuse(plant, "%s: at %.9g s the model gives no finite number; check %s there", what, t,
               model->margin_name[0] ? "that the mechanism can be assembled" : "the equations, states and parameters");
      add_pose(plant);
      break;
    case FLEX_NOT_DEFINITE:
      refuse(plant, "%s: at %.9g s the mass matrix is not positive definite; check masses and lengths", what, t);
      break;
    case FLEX_TOO_SINGULAR:
      refuse(plant, "%s: at %.9g s the %s is %.6g, but must be at least %.6g; keep away from the singularity", what, t,
             model->margin_name, value, model->minimum_margin);
      add_pose(plant);
      break;
    case FLEX_TOO_MANY_STEPS:
      refuse(plant, "%s: at %.9g s %.0f steps have been made within one communication step; %s%s", what, t, value,
             model->events_text ? "make the switch smooth, or switch with a distance, where one of these events happens again at once: "
                                : "make that shorter",
             model->events_text ? model->events_text : "");
      break;
    case FLEX_TOO_MUCH_WORK:
      refuse(plant,
             "%s: at %.9g s the equations of motion have been evaluated %lld times, more than %.3g times per second of motion: "
             "something changes far faster than it can matter, such as friction whose velocity is tiny; let it stick "
             "(joint_friction.kind = \"stiction\") or give it a larger velocity, take a larger tolerance, or a fixed "
             "integrator.step, which has no such limit",
             what, t, plant->record->stages.evaluations, value);
      break;
    case FLEX_NO_EQUILIBRIUM:
      refuse(plant,
             "%s: at %.9g s no static equilibrium was found, the last correction was %.3g; check masses and stiffnesses, or start "
             "undeformed (initial = 2)",
             what, t, value);
      break;
    case FLEX_BAD_SCALE:
      refuse(plant, "%s: the parameters give an unusable error norm; check masses, lengths and material", what);
      break;
    case FLEX_EVENTS_ACCUMULATE:
      refuse(plant,
             "%s: at %.9g s an event (%s) follows itself in ever shorter time, as the bounces of a ball that comes to rest; let a "
             "spring and damper carry it, switch with a distance, or end before",
             what, t, model->events_text);
      break;
    case FLEX_STEP_TOO_LONG:
      refuse(plant,
             "%s: at %.9g s the equations of motion cannot be solved with the fixed step %.6g s; make integrator.step smaller, "
             "or 0 for error control",
             what, t, value);
      break;
  }
  return 1;
}

/* the real variable that belongs to the integrator, not to the model */
static const flex_variable fixed_step = {"integrator.step", "s", 0.0, 0.0, HUGE_VAL, 0};

static unsigned fixed_step_index(const flex_plant *plant) {
  const flex_model *model = plant->model;
  return (unsigned)(model->n_inputs + model->n_parameters + model->n_outputs);
}

static int is_known(flex_plant *plant, unsigned index) {
  return !flex_refuse_reference(plant->message, index, fixed_step_index(plant) + 1);
}

int flex_get_real(flex_plant *plant, unsigned index, double *value) {
  const flex_model *model = plant->model;
  unsigned m = (unsigned)model->n_inputs, p = (unsigned)model->n_parameters;
  if (!is_known(plant, index)) return 1;
  if (index < m) {
    if (flex_explain(plant, "reading inputs", flex_plant_need_inputs(plant))) return 1;
    double shown = plant->shown_u[index];
    if (flex_refuse_input(plant->message, &model->input_variables[index], plant->record->time, shown)) return 1;
    *value = shown;
  } else if (index < m + p) {
    *value = plant->p[index - m];
  } else if (index == fixed_step_index(plant)) {
    *value = plant->record->fixed_step;
  } else {
    if (flex_explain(plant, "computing outputs", flex_plant_need_outputs(plant))) return 1;
    *value = plant->outputs[index - m - p];
  }
  return 0;
}

static int refuse_parameter(flex_plant *plant, const flex_variable *variable, double value) {
  if (plant->record->is_moving && !variable->tunable)
    return refuse(plant, "parameter %s is fixed once the motion has begun; reset the instance to change it", variable->name);
  return flex_refuse_value(plant->message, variable, value);
}

static int set_parameter(flex_plant *plant, int index, double value) {
  if (refuse_parameter(plant, &plant->model->parameter_variables[index], value)) return 1;
  if (plant->p[index] == value) return 0;
  plant->p[index] = value;
  flex_plant_parameters_changed(plant);
  return 0;
}

static int set_fixed_step(flex_plant *plant, double value) {
  if (refuse_parameter(plant, &fixed_step, value)) return 1;
  plant->record->fixed_step = value;
  flex_plant_start_changed(plant);
  return 0;
}

int flex_set_real(flex_plant *plant, unsigned index, double value) {
  const flex_model *model = plant->model;
  unsigned m = (unsigned)model->n_inputs, p = (unsigned)model->n_parameters;
  if (!is_known(plant, index)) return 1;
  if (index == fixed_step_index(plant)) return set_fixed_step(plant, value);
  if (index >= m + p) return refuse(plant, "%s is an output, it cannot be set", model->output_variables[index - m - p].name);
  if (index >= m) return set_parameter(plant, (int)(index - m), value);
  if (flex_refuse_value(plant->message, &model->input_variables[index], value)) return 1;
  flex_inputs_set(&plant->inputs, (int)index, plant->record->time, value);
  flex_plant_inputs_changed(plant);
  return 0;
}

static int clamped(long long count) {
  return count > INT_MAX ? INT_MAX : (int)count;
}

int flex_backend_get_integer(flex_backend *backend, unsigned index, int *value) {
  flex_plant *plant = plant_of(backend);
  const flex_plant_record *record = plant->record;
  switch (index) {
    case FLEX_INITIAL: *value = record->starts_static ? FLEX_STATIC : FLEX_UNDEFORMED; return 0;
    case FLEX_STEPS: *value = clamped(record->integrator.steps); return 0;
    case FLEX_REJECTIONS: *value = clamped(record->integrator.rejections); return 0;
    case FLEX_EVALUATIONS: *value = clamped(record->stages.evaluations); return 0;
    case FLEX_ITERATIONS: *value = clamped(record->stages.iterations); return 0;
    case FLEX_FACTORISATIONS: *value = clamped(record->stages.matrix.factorisations); return 0;
    case FLEX_INTEGRATOR: *value = record->method; return 0;
  }
  return refuse(plant, "value reference %u of an integer variable is unknown; there are %d", index, FLEX_N_INTEGERS);
}

static const char integrators[] = "1 (automatic), 2, 3, 4 (Gauss with so many stages), 5 (Radau IIA), 6 (Dormand-Prince), "
                                  "7 (classical Runge-Kutta) or 8 (Radau IIA, dense output)";

// 0 if a choice may be made now and has one of the values 1 to `last`
static int refuse_choice(flex_plant *plant, const char *name, int value, int last, const char *meanings) {
  if (value < 1 || value > last) return refuse(plant, "%s must be %s, got %d", name, meanings, value);
  if (!plant->record->is_moving) return 0;
  return refuse(plant, "%s is fixed once the motion has begun; reset the instance to change it", name);
}

int flex_backend_set_integer(flex_backend *backend, unsigned index, int value) {
  flex_plant *plant = plant_of(backend);
  switch (index) {
    case FLEX_INITIAL:
      if (refuse_choice(plant, "initial", value, FLEX_UNDEFORMED, "1 (static) or 2 (undeformed)")) return 1;
      plant->record->starts_static = value == FLEX_STATIC;
      flex_plant_start_changed(plant);
      return 0;
    case FLEX_INTEGRATOR:
      if (refuse_choice(plant, "integrator", value, FLEX_LAST_INTEGRATOR, integrators)) return 1;
      plant->record->method = value;
      flex_plant_start_changed(plant);
      return 0;
  }
  if (index < FLEX_N_INTEGERS)
    return refuse(plant, "integer variable %u counts the integrator's work, it cannot be set", index);
  return refuse(plant, "value reference %u of an integer variable is unknown; there are %d", index, FLEX_N_INTEGERS);
}

int flex_refuse_input_derivative(flex_plant *plant, unsigned index, int order, double value) {
  const flex_model *model = plant->model;
  if (index >= (unsigned)model->n_inputs)
    return refuse(plant, "value reference %u is no input, its derivatives cannot be set", index);
  const char *name = model->input_variables[index].name;
  return flex_refuse_derivative(plant->message, name, order, model->max_input_order, value);
}

int flex_get_output_derivative(flex_plant *plant, unsigned index, int order, double *value) {
  const flex_model *model = plant->model;
  unsigned output = flex_output_of(model, index);
  if (!is_known(plant, index)) return 1;
  if (output >= (unsigned)model->n_outputs)
    return refuse(plant, "value reference %u is no output, it has no derivatives", index);
  if (order < 1 || order > 2)
    return refuse(plant, "derivatives of %s are of order 1 or 2, got order %d", model->output_variables[output].name, order);
  if (flex_explain(plant, "computing output derivatives", flex_plant_need_rates(plant, order))) return 1;
  *value = (order == 1 ? plant->first_rates : plant->second_rates)[output];
  return 0;
}

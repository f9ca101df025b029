/* Directional derivatives of a plant: what small changes of inputs, parameters and states make of its outputs.
 *
 * Only products with one direction are formed, by forward differentiation of the generated functions; the accelerations
 * change by M da = -(change of the residual without da). Before the motion the coordinates follow from inputs and parameters,
 * by the implicit function theorem where they are a static equilibrium. Inputs are held, also those that were never set.
 *
 * Changes are followed in the order in which the plant computes: parameters, static equilibrium, accelerations, outputs. Each
 * stage is linear in what went before, so one direction costs one pass. */
#include <math.h>
#include <string.h>

#include "linear_algebra.h"
#include "variables.h"

#define refuse(plant, ...) flex_refuse((plant)->message, __VA_ARGS__)

// index of the state that an output shows, coordinates and rates one after the other; -1 if it shows none
static int state_of(const flex_model *model, unsigned output) {
  for (int i = 0; model->state_outputs && i < flex_state_coordinates(model) + flex_state_rates(model); i++)
    if (model->state_outputs[i] == (int)output) return i;
  return -1;
}

// where the change of an output belongs, if it shows a state; NULL after saying why there is no such place
static double *place_of_state(flex_plant *plant, unsigned output) {
  int coordinates = flex_state_coordinates(plant->model), state = state_of(plant->model, output);
  const char *name = plant->model->output_variables[output].name;
  if (state < 0)
    refuse(plant, "%s is neither an input nor a parameter nor a state, nothing can be differentiated by it", name);
  else if (!plant->record->is_moving)
    refuse(plant, "%s follows from inputs and parameters before the motion, nothing can be differentiated by it", name);
  else
    return state < coordinates ? plant->tangent.y + state : plant->tangent.v + (state - coordinates);
  return NULL;
}

// where the change of a known variable belongs; NULL after saying why there is no such place
static double *place_of(flex_plant *plant, unsigned index) {
  const flex_model *model = plant->model;
  unsigned m = (unsigned)model->n_inputs, settable = m + (unsigned)model->n_parameters;
  if (index < m) return plant->tangent.u + index;
  if (index < settable) return plant->tangent.p + (index - m);
  if (flex_refuse_reference(plant->message, index, settable + (unsigned)model->n_outputs)) return NULL;
  return place_of_state(plant, index - settable);
}

static int gather(flex_plant *plant, const flex_direction *direction) {
  flex_tangent_clear(&plant->tangent, plant->model);
  for (size_t i = 0; i < direction->n_known; i++) {
    unsigned index = direction->known[i];
    double change = direction->change[i], *place = place_of(plant, index);
    if (!place) return 1;
    if (!isfinite(change)) return refuse(plant, "the change of value reference %u must be finite, got %g", index, change);
    *place += change;
  }
  return 0;
}

// changes of derived parameters, and of the coordinates at the start
static int follow_parameters(flex_plant *plant) {
  const flex_model *model = plant->model;
  flex_tangent *tangent = &plant->tangent;

  // most directions leave the parameters alone
  int changed = 0;
  for (int i = 0; i < model->n_parameters; i++) changed |= tangent->p[i] != 0.0;
  if (!changed) return 0;

  // derived parameters follow always, the start only before the motion
  const double *const arguments[] = {plant->p, tangent->p};
  if (flex_call(&plant->equations, &model->start_forward, 2, arguments, tangent->start)) return 1;
  memcpy(tangent->d, tangent->start, (size_t)model->n_derived * sizeof(double));
  if (plant->record->is_moving) return 0;
  const double *start = tangent->start + model->n_derived;
  memcpy(tangent->y, start, (size_t)model->n * sizeof(double));
  if (model->n_start > model->n) memcpy(tangent->v, start + model->n, (size_t)model->n * sizeof(double));
  return 0;
}

// stiffness dr/dy of the free unknowns at rest, factorised
static int factor_stiffness(flex_plant *plant, const flex_point *rest) {
  int n = plant->model->n, locked = plant->model->n_locked, free = n - locked, refused = 0;
  double *unit = plant->tangent.unit, *column = plant->tangent.changes, *stiffness = plant->statics.stiffness;
  const flex_point change = {unit, plant->zero, NULL, plant->zero, plant->zero};
  memset(unit, 0, (size_t)n * sizeof *unit);
  for (int k = 0; k < free; k++) {
    unit[locked + k] = 1.0;
    refused |= flex_motion_forward(&plant->equations, rest, &change, column);
    memcpy(stiffness + k * free, column + locked, (size_t)free * sizeof *column);
    unit[locked + k] = 0.0;
  }
  return refused || flex_lu_factor(free, stiffness, plant->statics.pivots);
}

// change of the static equilibrium: free unknowns keep the balance
static int follow_equilibrium(flex_plant *plant) {
  const flex_model *model = plant->model;
  flex_tangent *tangent = &plant->tangent;
  int n = model->n, m = model->n_inputs, locked = model->n_locked, free = n - locked;
  const double *u = flex_plant_inputs_at_rest(plant), *zero = plant->zero;
  const flex_point rest = {plant->integrator.y, zero, zero, u, plant->d};
  if (factor_stiffness(plant, &rest)) return 1;

  // rates among the inputs stay zero at rest
  double *dy = tangent->y, *du = tangent->rest_u, *dr = tangent->changes;
  memset(dy + locked, 0, (size_t)free * sizeof *dy);
  memcpy(du, tangent->u, (size_t)m * sizeof *du);
  for (int i = m - model->n_rate_inputs; i < m; i++) du[i] = 0.0;

  // implicit function theorem: K dy = -dr
  const flex_point change = {dy, zero, NULL, du, tangent->d};
  if (flex_motion_forward(&plant->equations, &rest, &change, dr)) return 1;
  flex_lu_solve(free, plant->statics.stiffness, plant->statics.pivots, dr + locked);
  for (int i = locked; i < n; i++) dy[i] = -dr[i];
  return 0;
}

// changes of accelerations and outputs with those of everything else: M da = -(dr with the acceleration held)
static int follow_motion(flex_plant *plant) {
  const flex_model *model = plant->model;
  const flex_integrator *now = &plant->integrator;
  const flex_tangent *tangent = &plant->tangent;
  const flex_point at = {now->y, now->v, now->a, plant->u, plant->d};
  const flex_point change = {tangent->y, tangent->v, NULL, tangent->u, tangent->d};
  double *da = tangent->changes, *outputs = da + model->n, *entries = outputs + model->n_outputs;

  // changes of residual and outputs at constant acceleration, then the acceleration's own part
  if (flex_motion_forward(&plant->equations, &at, &change, tangent->changes)) return 1;
  flex_cholesky_solve(model->n, now->mass_factor, da);
  for (int i = 0; i < model->n; i++) da[i] = -da[i];
  flex_add_acceleration(model, entries, da, outputs);
  return 0;
}

// changes of all outputs with what was gathered
static flex_failure follow(flex_plant *plant) {
  const flex_plant_record *record = plant->record;
  flex_failure failure = flex_plant_need_acceleration(plant);
  if (failure.outcome != FLEX_DONE) return failure;
  int refused = follow_parameters(plant);
  if (!refused && !record->is_moving && record->starts_static) refused = follow_equilibrium(plant);
  failure.outcome = flex_integrator_factor(&plant->integrator, plant->u);
  if (failure.outcome != FLEX_DONE) return failure;
  if (refused || follow_motion(plant)) failure.outcome = FLEX_NOT_FINITE;
  return failure;
}

int flex_backend_differentiate(flex_backend *backend, const flex_direction *direction) {
  flex_plant *plant = plant_of(backend);
  unsigned first = (unsigned)(plant->model->n_inputs + plant->model->n_parameters);
  if (gather(plant, direction)) return 1;
  if (flex_explain(plant, "differentiation", follow(plant))) return 1;

  // changes of the outputs that were asked for
  const double *changed_outputs = plant->tangent.changes + plant->model->n;
  for (size_t i = 0; i < direction->n_unknown; i++) {
    unsigned index = direction->unknown[i];
    if (flex_refuse_reference(plant->message, index, first + (unsigned)plant->model->n_outputs)) return 1;
    if (index < first) return refuse(plant, "value reference %u is no output, it has no directional derivative", index);
    double change = changed_outputs[index - first];
    if (!isfinite(change))
      return refuse(plant, "the directional derivative of %s is no finite number here",
                    plant->model->output_variables[index - first].name);
    direction->result[i] = change;
  }
  return 0;
}

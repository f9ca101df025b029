#include "directional.h"

#include <math.h>
#include <string.h>

#include "linear_algebra.h"
#include "variables.h"

#define refuse(plant, ...) flex_refuse((plant)->message, __VA_ARGS__)

/* arguments of residual and outputs, or their changes */
typedef struct {
  const double *y, *v, *a, *u, *d;
} flex_point;

// index of the state that an output shows, y and v one after the other; -1 if it shows none
static int state_of(const flex_model *model, unsigned output) {
  for (int i = 0; model->state_outputs && i < 2 * model->n; i++)
    if (model->state_outputs[i] == (int)output) return i;
  return -1;
}

// where the change of an output belongs, if it shows a state; NULL after saying why there is no such place
static double *place_of_state(flex_plant *plant, unsigned output) {
  int n = plant->model->n, state = state_of(plant->model, output);
  const char *name = plant->model->output_variables[output].name;
  if (state < 0)
    refuse(plant, "%s is neither an input nor a parameter nor a state, nothing can be differentiated by it", name);
  else if (!plant->record->is_moving)
    refuse(plant, "%s follows from inputs and parameters before the motion, nothing can be differentiated by it", name);
  else
    return state < n ? plant->tangent.y + state : plant->tangent.v + (state - n);
  return NULL;
}

// where the change of a known variable belongs; NULL after saying why there is no such place
static double *place_of(flex_plant *plant, unsigned index) {
  const flex_model *model = plant->model;
  unsigned m = (unsigned)model->n_inputs, settable = m + (unsigned)model->n_parameters;
  if (index < m) return plant->tangent.u + index;
  if (index < settable) return plant->tangent.p + (index - m);
  if (flex_refuse_reference(plant->message, index, (int)settable + model->n_outputs)) return NULL;
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

static int differentiate(flex_plant *plant, const flex_function *function, const flex_point *at, const flex_point *change,
                         double *result) {
  const double *const arguments[] = {at->y,     at->v,     at->a,     at->u,     at->d,
                                     change->y, change->v, change->a, change->u, change->d};
  return flex_call(&plant->equations, function, 10, arguments, result);
}

// changes of derived parameters, and of start coordinates and inputs that nobody has set
static int follow_parameters(flex_plant *plant) {
  const flex_model *model = plant->model;
  flex_tangent *tangent = &plant->tangent;
  int changed = 0;
  for (int i = 0; i < model->n_parameters; i++) changed |= tangent->p[i] != 0.0;
  if (!changed) return 0;
  const double *const arguments[] = {plant->p, tangent->p};
  if (flex_call(&plant->equations, &model->start_forward, 2, arguments, tangent->start)) return 1;

  const double *y = tangent->start + model->n_derived, *u = y + model->n;
  memcpy(tangent->d, tangent->start, (size_t)model->n_derived * sizeof *y);
  if (plant->record->is_moving) return 0;
  memcpy(tangent->y, y, (size_t)model->n * sizeof *y);
  for (int i = 0; i < model->n_inputs; i++)
    if (!plant->inputs.given[i]) tangent->u[i] += u[i];
  return 0;
}

// stiffness dr/dy of the free unknowns at rest, factorised
static int factor_stiffness(flex_plant *plant, const flex_point *rest) {
  int n = plant->model->n, locked = plant->model->n_locked, free = n - locked, refused = 0;
  double *unit = plant->tangent.a, *column = plant->tangent.residual, *stiffness = plant->statics.stiffness;
  const flex_point change = {unit, plant->zero, plant->zero, plant->zero, plant->zero};
  memset(unit, 0, (size_t)n * sizeof *unit);
  for (int k = 0; k < free; k++) {
    unit[locked + k] = 1.0;
    refused |= differentiate(plant, &plant->model->residual_forward, rest, &change, column);
    memcpy(stiffness + k * free, column + locked, (size_t)free * sizeof *column);
    unit[locked + k] = 0.0;
  }
  return refused || flex_lu_factor(free, stiffness, plant->statics.pivots);
}

// change of the static equilibrium, and of forces that nobody has set and that hold the locked unknowns there
static flex_outcome follow_rest(flex_plant *plant, double *value) {
  const flex_model *model = plant->model;
  flex_tangent *tangent = &plant->tangent;
  int n = model->n, m = model->n_inputs, locked = model->n_locked, free = n - locked;
  double *y = plant->integrator.full_y, *dy = tangent->rest_y, *du = tangent->rest_u, *dr = tangent->residual;
  flex_outcome outcome = flex_plant_rest(plant, y, value);
  if (outcome != FLEX_DONE) return outcome;
  const flex_point rest = {y, plant->zero, plant->zero, plant->u2, plant->d};
  if (factor_stiffness(plant, &rest)) return FLEX_NOT_FINITE;

  // locked unknowns and inputs as given, but for rates, which are zero at rest
  memcpy(dy, tangent->y, (size_t)locked * sizeof *dy);
  memset(dy + locked, 0, (size_t)free * sizeof *dy);
  memcpy(du, tangent->u, (size_t)m * sizeof *du);
  for (int i = m - model->n_rate_inputs; i < m; i++) du[i] = 0.0;

  // free unknowns keep the balance
  const flex_point change = {dy, plant->zero, plant->zero, du, tangent->d};
  if (differentiate(plant, &model->residual_forward, &rest, &change, dr)) return FLEX_NOT_FINITE;
  flex_lu_solve(free, plant->statics.stiffness, plant->statics.pivots, dr + locked);
  for (int i = locked; i < n; i++) dy[i] = -dr[i];

  // forces take up what is left
  if (differentiate(plant, &model->residual_forward, &rest, &change, dr)) return FLEX_NOT_FINITE;
  for (int i = 0; i < locked; i++)
    if (!plant->inputs.given[i]) tangent->u[i] += dr[i];
  if (plant->record->starts_static) memcpy(tangent->y, dy, (size_t)n * sizeof *dy);
  return FLEX_DONE;
}

// changes of accelerations and outputs with those of everything else
static int follow_motion(flex_plant *plant) {
  const flex_model *model = plant->model;
  const flex_integrator *now = &plant->integrator;
  flex_tangent *tangent = &plant->tangent;
  int n = model->n, refused = 0;
  const flex_point at = {now->y, now->v, now->a, plant->u, plant->d};
  if (n > 0) {
    const flex_point held = {tangent->y, tangent->v, plant->zero, tangent->u, tangent->d};
    refused |= differentiate(plant, &model->residual_forward, &at, &held, tangent->a);
    flex_cholesky_solve(n, now->mass_factor, tangent->a);
    for (int i = 0; i < n; i++) tangent->a[i] = -tangent->a[i];
  }
  const flex_point change = {tangent->y, tangent->v, tangent->a, tangent->u, tangent->d};
  return refused | differentiate(plant, &model->outputs_forward, &at, &change, tangent->outputs);
}

// changes of all outputs with what was gathered
static flex_failure follow(flex_plant *plant) {
  flex_failure failure = flex_plant_need_acceleration(plant);
  if (failure.outcome != FLEX_DONE) return failure;
  if (follow_parameters(plant)) failure.outcome = FLEX_NOT_FINITE;
  if (failure.outcome == FLEX_DONE && !plant->record->is_moving && flex_plant_rests(plant))
    failure.outcome = follow_rest(plant, &failure.value);
  if (failure.outcome == FLEX_DONE && follow_motion(plant)) failure.outcome = FLEX_NOT_FINITE;
  return failure;
}

int flex_differentiate(flex_plant *plant, const flex_direction *direction) {
  unsigned first = (unsigned)(plant->model->n_inputs + plant->model->n_parameters);
  if (gather(plant, direction)) return 1;
  flex_failure failure = follow(plant);
  if (failure.outcome != FLEX_DONE) flex_explain(plant, "differentiation", &failure);
  if (failure.outcome != FLEX_DONE) return 1;

  for (size_t i = 0; i < direction->n_unknown; i++) {
    unsigned index = direction->unknown[i];
    if (flex_refuse_reference(plant->message, index, (int)first + plant->model->n_outputs)) return 1;
    if (index < first) return refuse(plant, "value reference %u is no output, it has no directional derivative", index);
    double change = plant->tangent.outputs[index - first];
    if (!isfinite(change))
      return refuse(plant, "the directional derivative of %s is no finite number here",
                    plant->model->output_variables[index - first].name);
    direction->result[i] = change;
  }
  return 0;
}

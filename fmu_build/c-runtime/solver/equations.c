#include "equations.h"

static void widen(const flex_function *function, int *n_arg, int *n_res, int *n_iw, int *n_w) {
  if (function->n_arg > *n_arg) *n_arg = function->n_arg;
  if (function->n_res > *n_res) *n_res = function->n_res;
  if (function->n_iw > *n_iw) *n_iw = function->n_iw;
  if (function->n_w > *n_w) *n_w = function->n_w;
}

size_t flex_changes_count(const flex_model *model) {
  return (size_t)model->n + (size_t)model->n_outputs + (size_t)model->n_acceleration_terms;
}

void flex_equations_take(flex_equations *equations, const flex_model *model, flex_arena *arena) {
  const flex_function *functions[] = {&model->derive,         &model->initial_inputs, &model->residual,
                                      &model->mass_matrix,    &model->outputs,        &model->motion_forward,
                                      &model->motion_rate1,   &model->motion_rate2,   &model->singularity,
                                      &model->error_scale,    &model->initial_coordinates, &model->start_forward,
                                      &model->event_numbers,  &model->event_resets,  &model->jacobian};

  // the largest work space that any function needs, at least room for the arguments
  int n_arg = 9, n_res = 1, n_iw = 1, n_w = 1;
  for (size_t i = 0; i < sizeof functions / sizeof *functions; i++) widen(functions[i], &n_arg, &n_res, &n_iw, &n_w);

  equations->model = model;
  equations->arg = flex_take(arena, (size_t)n_arg * sizeof *equations->arg);
  equations->res = flex_take(arena, (size_t)n_res * sizeof *equations->res);
  equations->iw = flex_take_ints(arena, (size_t)n_iw);
  equations->w = flex_take_reals(arena, (size_t)n_w);
  equations->holding = flex_take_reals(arena, (size_t)model->n_frictions);
  equations->earlier_modes = flex_take_ints(arena, (size_t)flex_switches(model));
  equations->crossings = flex_take_reals(arena, 2 * (size_t)model->n_events);
  equations->fired = flex_take_reals(arena, (size_t)model->n_events);
}

void flex_set_mode(flex_equations *equations, int place, int mode) {
  const flex_model *model = equations->model;
  int event = place - model->n_frictions;
  equations->modes[place] = mode;
  equations->d[event < 0 ? model->frictions[place].direction : model->events[event].side] = flex_real((mode == FLEX_FORWARD) - (mode == FLEX_BACKWARD));
}

void flex_show_modes(flex_equations *equations) {
  for (int k = 0; k < flex_switches(equations->model); k++) flex_set_mode(equations, k, equations->modes[k]);
}

int flex_is_held(const flex_equations *equations, int unknown) {
  const flex_model *model = equations->model;
  for (int k = 0; k < model->n_frictions; k++)
    if (model->frictions[k].unknown == unknown && equations->modes[k] == FLEX_STUCK) return 1;
  return 0;
}

void flex_hold(const flex_equations *equations, real *rates) {
  const flex_model *model = equations->model;
  for (int k = 0; k < model->n_frictions; k++)
    if (equations->modes[k] == FLEX_STUCK) rates[model->frictions[k].unknown] = flex_real(0.0);
}

// what the residual lacks is the force of friction; the equation becomes a = 0
static void hold_residual(flex_equations *equations, const real *a, real *r) {
  for (int k = 0; k < equations->model->n_frictions; k++) {
    int i = equations->model->frictions[k].unknown;
    if (equations->modes[k] != FLEX_STUCK) continue;
    equations->holding[k] = -r[i];
    r[i] = a[i];
  }
}

void flex_hold_mass(const flex_equations *equations, real *mass) {
  int n = equations->model->n;
  for (int k = 0; k < equations->model->n_frictions; k++) {
    int i = equations->model->frictions[k].unknown;
    if (equations->modes[k] != FLEX_STUCK) continue;
    for (int j = 0; j < n; j++) mass[i * n + j] = mass[j * n + i] = flex_real(0.0);
    mass[i * n + i] = flex_real(1.0);
  }
}

int flex_residual(flex_equations *equations, const real *y, const real *v, const real *a, const real *u, real *r) {
  const real **arg = equations->arg;
  arg[0] = y;
  arg[1] = v;
  arg[2] = a;
  arg[3] = u;
  arg[4] = equations->d;
  equations->res[0] = r;
  ++*equations->evaluations;
  int refused = equations->model->residual.call(arg, equations->res, equations->iw, equations->w, 0);
  if (equations->model->n_frictions > 0) hold_residual(equations, a, r);
  return refused;
}

int flex_lanes_serve(const flex_equations *equations) {
  const flex_model *model = equations->model;
  return FLEX_WIDTH == 1 && equations->has_lanes && model->residual_lanes != 0 && model->n_frictions == 0;
}

#if FLEX_WIDTH == 1
void flex_residual_lanes(flex_equations *equations, int count, const real *y, const real *v, const real *a,
                         const real *u, real *r) {
  *equations->evaluations += count;
  equations->model->residual_lanes(y, v, a, u, equations->d, r);
}
#endif

int flex_mass_matrix(flex_equations *equations, const real *y, const real *u, real *mass) {
  const real *const arguments[] = {y, u, equations->d};
  int refused = flex_call(equations, &equations->model->mass_matrix, 3, arguments, mass);
  flex_hold_mass(equations, mass);
  return refused;
}

int flex_margin(flex_equations *equations, const real *y, const real *u, double *margin) {
  const real *const arguments[] = {y, u, equations->d};
  real margins;
  int refused = flex_call(equations, &equations->model->singularity, 3, arguments, &margins);
  *margin = flex_least(margins);
  return refused;
}

int flex_call(flex_equations *equations, const flex_function *function, int n_arguments, const real *const *arguments,
              real *result) {
  for (int i = 0; i < n_arguments; i++) equations->arg[i] = arguments[i];
  equations->res[0] = result;
  return function->call(equations->arg, equations->res, equations->iw, equations->w, 0);
}

int flex_motion_forward(flex_equations *equations, const flex_point *at, const flex_point *change, real *changes) {
  const real *const arguments[] = {at->y, at->v, at->a, at->u, at->d, change->y, change->v, change->u, change->d};
  int refused = flex_call(equations, &equations->model->motion_forward, 9, arguments, changes);
  flex_hold(equations, changes);
  return refused;
}

void flex_add_acceleration(const flex_model *model, const real *entries, const real *a, real *outputs) {
  const flex_term *terms = model->acceleration_terms;
  for (int k = 0; k < model->n_acceleration_terms; k++) outputs[terms[k].output] += entries[k] * a[terms[k].unknown];
}

/* The plant computes on demand: each value has a flag that says whether it belongs to the present state, inputs and parameters;
 * a change clears the flags of all that depends on it, a question fills in what is missing. */
#include "plant.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "friction.h"
#include "integration_step.h"
#include "lanes.h"
#include "linear_algebra.h"

/* rounding errors of the polynomials that inputs are between communication points, in units of what they reach there */
#define INPUT_ROUNDING (256.0 * DBL_EPSILON)

/* a coordinate with ten times critical damping, whose rate of decay [1/s] is far above what motions need resolved */
#define OVERDAMPED 20.0
#define FAST_DECAY 1e5

/* what depends on the point of the motion */
#define POINT (FLEX_HAVE_ACCELERATION | FLEX_HAVE_OUTPUTS | FLEX_HAVE_FIRST_RATES | FLEX_HAVE_SECOND_RATES)

// pieces of an instance in memory; the numeric state first
static void take(flex_plant *plant, const flex_model *model, flex_arena *arena) {
  size_t n = (size_t)model->n, m = (size_t)model->n_inputs, outputs = (size_t)model->n_outputs;

  // numeric state
  size_t begin = arena->used;
  plant->record = flex_take(arena, sizeof *plant->record);
  plant->p = flex_take_reals(arena, (size_t)model->n_parameters);
  plant->d = flex_take_reals(arena, (size_t)model->n_derived);
  plant->scale = flex_take_reals(arena, 2 * n + 1);
  plant->u = flex_take_reals(arena, m);
  plant->previous_u = flex_take_reals(arena, m);
  plant->outputs = flex_take_reals(arena, outputs);
  plant->modes = flex_take_ints(arena, (size_t)flex_switches(model));
  plant->forgiven = flex_take_doubles(arena, (size_t)model->n_events);
  flex_inputs_take(&plant->inputs, model->n_inputs, model->max_input_order, arena);
  flex_integrator_take_state(&plant->integrator, model, arena);
  plant->state_size = arena->used - begin;

  // scratch
  int n_shared = model->motion_rate1.n_w > model->motion_rate2.n_w ? model->motion_rate1.n_w : model->motion_rate2.n_w;
  plant->jerk = flex_take_reals(arena, flex_changes_count(model) + n * n + outputs);
  plant->snap = flex_take_reals(arena, n + outputs);
  plant->shared = flex_take_reals(arena, (size_t)n_shared);
  flex_integrator_take_scratch(&plant->integrator, model->n, model->n_inputs, arena);
  flex_equations_take(&plant->equations, model, arena);
  flex_statics_take(&plant->statics, model->n, arena);
  plant->u1 = flex_take_reals(arena, m);
  plant->u2 = flex_take_reals(arena, m);
  plant->shown_u = flex_take_reals(arena, m);
  plant->indicators = flex_take_doubles(arena, (size_t)flex_switches(model));
  plant->zero = flex_take_reals(arena, n + m + (size_t)model->n_derived);
  flex_tangent_take(&plant->tangent, model, arena);
}

size_t flex_plant_size(const flex_model *model) {
  flex_plant plant;
  flex_arena arena = {NULL, 0};
  flex_take(&arena, sizeof plant);
  take(&plant, model, &arena);
  return arena.used;
}

flex_plant *flex_plant_create(const flex_model *model, void *memory) {
  flex_arena arena = {memory, 0};
  flex_plant *plant = flex_take(&arena, sizeof *plant);
  take(plant, model, &arena);
  plant->model = model;

  // results of the functions that give rates lie one after the other
  plant->first_rates = plant->jerk + model->n;
  plant->acceleration_entries = plant->first_rates + model->n_outputs;
  plant->second_rates = plant->snap + model->n;

  // seams between the parts
  flex_integrator *integrator = &plant->integrator;
  plant->equations.d = plant->d;
  plant->equations.has_lanes = flex_has_lanes();
  plant->equations.modes = plant->modes;
  plant->equations.forgiven = plant->forgiven;
  plant->equations.evaluations = &plant->record->stages.evaluations;
  integrator->record = &plant->record->integrator;
  integrator->stages.record = &plant->record->stages;
  integrator->stages.matrix.record = &plant->record->stages.matrix;
  integrator->stages.equations = &plant->equations;
  integrator->stages.inputs = &plant->inputs;
  integrator->stages.position_weight = plant->scale;
  integrator->stages.rate_weight = plant->scale + model->n;
  integrator->floor = plant->scale + 2 * model->n;
  integrator->stages.pace = flex_real(1.0);
  integrator->fixed_step = &plant->record->fixed_step;
  flex_plant_reset(plant);
  return plant;
}

static void choose_method(flex_plant *plant) {
  const flex_plant_record *record = plant->record;
  const flex_method *method =
      flex_find_method(record->method, record->tolerance, plant->model->is_damped, record->is_overdamped);
  flex_integrator_use(&plant->integrator, method, record->tolerance);
}

void flex_plant_reset(flex_plant *plant) {
  const flex_model *model = plant->model;
  memset(plant->record, 0, plant->state_size);
  plant->record->tolerance = model->default_tolerance;
  plant->record->starts_static = model->static_start;
  plant->record->method = FLEX_AUTOMATIC;
  for (int i = 0; i < model->n_parameters; i++) plant->p[i] = flex_real(model->parameter_variables[i].start);
  flex_inputs_clear(&plant->inputs);
  plant->message[0] = '\0';
  choose_method(plant);
}

void flex_plant_set_start_time(flex_plant *plant, double time) {
  plant->record->time = time;
  for (int i = 0; i < plant->inputs.count; i++) plant->inputs.base[i] = time;
  flex_plant_start_changed(plant);
}

void flex_plant_restored(flex_plant *plant) {
  plant->record->have &= ~(FLEX_HAVE_FIRST_RATES | FLEX_HAVE_SECOND_RATES);
  choose_method(plant);
}

void flex_plant_parameters_changed(flex_plant *plant) {
  plant->record->have &= ~(FLEX_HAVE_DERIVED | FLEX_HAVE_START | POINT);
  flex_newton_clear(&plant->integrator.stages.matrix);
}

void flex_plant_moved(flex_plant *plant) {
  plant->record->have &= ~POINT;
}

void flex_plant_start_changed(flex_plant *plant) {
  plant->record->have &= ~(FLEX_HAVE_START | POINT);
}

void flex_plant_set_clock(flex_plant *plant) {
  int last = plant->model->n - 1;
  if (!plant->model->has_clock) return;
  plant->integrator.y[last] = flex_real(plant->record->time);
  plant->integrator.y_rest[last] = flex_real(0.0);
}

static flex_failure outcome_now(const flex_plant *plant, flex_outcome outcome, double value) {
  flex_failure failure = {outcome, plant->record->time, value};
  return failure;
}

// derived parameters and error norm
static flex_outcome need_derived(flex_plant *plant) {
  const flex_model *model = plant->model;
  if (plant->record->have & FLEX_HAVE_DERIVED) return FLEX_DONE;
  const real *const p[] = {plant->p}, *const d[] = {plant->d};
  if (flex_call(&plant->equations, &model->derive, 1, p, plant->d)) return FLEX_NOT_FINITE;
  if (!flex_all_finite(plant->d, model->n_derived)) return FLEX_NOT_FINITE;
  flex_show_modes(&plant->equations);
  if (flex_call(&plant->equations, &model->error_scale, 1, d, plant->scale)) return FLEX_BAD_SCALE;

  // weights must be usable as such
  for (int i = 0; i < 2 * model->n; i++)
    if (!flex_is_zero_or_more(plant->scale[i]) || !flex_is_finite(plant->scale[i])) return FLEX_BAD_SCALE;
  real floor = *plant->integrator.floor;
  if (model->n > 0 && (!flex_is_positive(floor) || !flex_is_finite(floor))) return FLEX_BAD_SCALE;
  plant->record->have |= FLEX_HAVE_DERIVED;
  return FLEX_DONE;
}

// values of inputs that were never set
static flex_outcome need_start_inputs(flex_plant *plant) {
  const real *const p[] = {plant->p};
  if (flex_call(&plant->equations, &plant->model->initial_inputs, 1, p, plant->shown_u)) return FLEX_NOT_FINITE;
  for (int i = 0; i < plant->inputs.count; i++)
    if (!plant->inputs.given[i]) flex_inputs_default(&plant->inputs, i, plant->shown_u[i]);
  flex_inputs_evaluate(&plant->inputs, plant->record->time, 0.0, plant->u);
  return flex_all_finite(plant->u, plant->inputs.count) ? FLEX_DONE : FLEX_NOT_FINITE;
}

// the undeformed pose, at rest unless the model gives rates, which lie behind the coordinates; it must be admissible
static flex_outcome start_undeformed(flex_plant *plant, double *margin) {
  flex_integrator *integrator = &plant->integrator;
  const real *const p[] = {plant->p};
  size_t size = (size_t)plant->model->n * sizeof(real);
  memset(integrator->v, 0, size);
  memset(integrator->a, 0, size);
  for (int k = 0; k < flex_switches(plant->model); k++) flex_set_mode(&plant->equations, k, FLEX_FREE);
  if (flex_call(&plant->equations, &plant->model->initial_coordinates, 1, p, integrator->y)) return FLEX_NOT_FINITE;
  if (!flex_all_finite(integrator->y, plant->model->n) || !flex_all_finite(integrator->v, plant->model->n)) return FLEX_NOT_FINITE;
  flex_plant_set_clock(plant);
  flex_outcome outcome = need_start_inputs(plant);
  if (outcome != FLEX_DONE) return outcome;
  if (flex_margin(&plant->equations, integrator->y, plant->u, margin)) return FLEX_NOT_FINITE;
  return *margin >= plant->model->minimum_margin ? FLEX_DONE : FLEX_TOO_SINGULAR;
}

const real *flex_plant_inputs_at_rest(flex_plant *plant) {
  int count = plant->inputs.count, rates = plant->model->n_rate_inputs;
  memcpy(plant->u2, plant->u, (size_t)count * sizeof(real));
  for (int i = count - rates; i < count; i++) plant->u2[i] = flex_real(0.0);
  return plant->u2;
}

// forces that were never set hold the locked unknowns against the static loads
static flex_outcome hold_locked(flex_plant *plant, const real *u, const real *y) {
  flex_statics *statics = &plant->statics;
  if (flex_statics_forces(statics, &plant->equations, u, y)) return FLEX_NOT_FINITE;
  for (int i = 0; i < plant->model->n_locked; i++)
    if (!plant->inputs.given[i]) flex_inputs_default(&plant->inputs, i, u[i] + statics->residual[i]);
  flex_inputs_evaluate(&plant->inputs, plant->record->time, 0.0, plant->u);
  return flex_all_finite(plant->u, plant->inputs.count) ? FLEX_DONE : FLEX_NOT_FINITE;
}

static int needs_holding(const flex_plant *plant) {
  for (int i = 0; i < plant->model->n_locked; i++)
    if (!plant->inputs.given[i]) return 1;
  return 0;
}

// deflection under the static loads, where the motion starts from it or forces must hold it
static flex_outcome start_static(flex_plant *plant, double *value) {
  flex_integrator *integrator = &plant->integrator;
  int holds = needs_holding(plant);
  if (!plant->record->starts_static && !holds) return FLEX_DONE;
  size_t size = (size_t)plant->model->n * sizeof(real);
  const real *u = flex_plant_inputs_at_rest(plant);
  real *y = integrator->full_y;
  memcpy(y, integrator->y, size);
  flex_outcome outcome =
      flex_statics_solve(&plant->statics, &plant->equations, plant->scale, *integrator->floor, u, y, value);
  if (outcome == FLEX_DONE && holds) outcome = hold_locked(plant, u, y);
  if (outcome == FLEX_DONE && plant->record->starts_static) memcpy(integrator->y, y, size);
  return outcome;
}

// whether a coordinate decays far faster than it vibrates, by the diagonals of mass, damping and stiffness at the start; states of
// first order, whose rates of decay may grow by decades, always count as such
static int find_overdamped(flex_plant *plant) {
  flex_integrator *integrator = &plant->integrator;
  flex_newton_matrix *matrix = &integrator->stages.matrix;
  const flex_model *model = plant->model;
  int n = model->n, found = 0;
  long long evaluations = *plant->equations.evaluations;
  if (n == 0 || !model->is_damped) return 0;
  if (model->n_first > 0) return 1;
  int refused = flex_newton_refresh(matrix, &plant->equations, integrator->y, integrator->v, integrator->a, plant->u,
                                    plant->scale, plant->scale + n, *integrator->floor);

  // each coordinate by itself
  for (int i = 0; !refused && i < n; i++) {
    int diagonal = model->sparse ? model->sparse->diagonals[i] : i * n + i;
    real m = matrix->mass[diagonal], d = matrix->damping[diagonal], k = matrix->stiffness[diagonal];
    found |= !flex_is_zero_or_more(flex_larger(OVERDAMPED * flex_sqrt(flex_fabs(k) * m) - d, FAST_DECAY * m - d));
  }
  flex_newton_clear(matrix);
  *plant->equations.evaluations = evaluations;
  return found;
}

// state at the start of the motion
flex_failure flex_plant_need_start(flex_plant *plant) {
  flex_plant_record *record = plant->record;
  double value = 0.0;
  flex_outcome outcome = need_derived(plant);
  if (outcome != FLEX_DONE || record->is_moving || (record->have & FLEX_HAVE_START))
    return outcome_now(plant, outcome, value);

  // pose, then the method that suits the model there
  outcome = start_undeformed(plant, &value);
  if (outcome == FLEX_DONE) outcome = start_static(plant, &value);
  if (outcome != FLEX_DONE) return outcome_now(plant, outcome, value);
  record->is_overdamped = find_overdamped(plant);
  choose_method(plant);
  flex_integrator_start(&plant->integrator);
  record->have = (record->have | FLEX_HAVE_START) & ~POINT;
  return outcome_now(plant, FLEX_DONE, 0.0);
}

flex_failure flex_plant_need_inputs(flex_plant *plant) {
  flex_outcome outcome = FLEX_DONE;
  if (!plant->record->is_moving)
    outcome = plant->model->n_locked > 0 ? flex_plant_need_start(plant).outcome : need_start_inputs(plant);
  flex_inputs_evaluate(&plant->inputs, plant->record->time, 0.0, plant->shown_u);
  return outcome_now(plant, outcome, 0.0);
}

// whether inputs that were set anew are what their polynomials had come to, but for rounding errors
static int go_on(const flex_plant *plant, const real *u) {
  for (int i = 0; i < plant->inputs.count; i++) {
    real reached = flex_larger(flex_fabs(plant->u[i]), flex_fabs(plant->previous_u[i]));
    if (!flex_is_zero_or_more(INPUT_ROUNDING * reached - flex_fabs(u[i] - plant->u[i]))) return 0;
  }
  return 1;
}

// acceleration for the inputs u, with the modes of friction that belong to them unless these are held
static flex_outcome accelerate(flex_plant *plant, int modes_are_held, int *stopped) {
  flex_integrator *integrator = &plant->integrator;
  int settles = FLEX_WIDTH == 1 && flex_switches(plant->model) > 0 && !modes_are_held;
  plant->record->have &= ~POINT;
  flex_integrator_drop(integrator);
  flex_outcome outcome = settles ? flex_friction_settle(integrator, plant->u, stopped)
                                 : flex_step_accelerate_present(integrator, plant->u);
  if (outcome == FLEX_DONE) plant->record->have |= FLEX_HAVE_ACCELERATION;
  return outcome;
}

flex_failure flex_plant_settle(flex_plant *plant, int holds, int *stopped) {
  flex_failure failure = flex_plant_need_start(plant);
  if (failure.outcome != FLEX_DONE || flex_switches(plant->model) == 0) return failure;
  flex_inputs_evaluate(&plant->inputs, plant->record->time, 0.0, plant->u);
  plant->record->integrator.modes_are_held = holds;
  plant->record->integrator.at_event = 0;
  return outcome_now(plant, accelerate(plant, 0, stopped), 0.0);
}

flex_failure flex_plant_indicators(flex_plant *plant, double *indicators) {
  flex_failure failure = flex_plant_need_acceleration(plant);
  if (failure.outcome != FLEX_DONE || FLEX_WIDTH > 1 || flex_switches(plant->model) == 0) return failure;
  return outcome_now(plant, flex_friction_indicators(&plant->integrator, plant->u, indicators), 0.0);
}

int flex_plant_has_event(flex_plant *plant) {
  int count = flex_switches(plant->model), has_event = 0;
  if (count == 0 || flex_plant_indicators(plant, plant->indicators).outcome != FLEX_DONE) return 0;
  for (int k = 0; k < count; k++) has_event |= plant->indicators[k] < 0.0;
  return has_event;
}

// acceleration for the present inputs, right-sided where they jump
flex_failure flex_plant_need_acceleration(flex_plant *plant) {
  flex_plant_record *record = plant->record;
  flex_failure failure = flex_plant_need_start(plant);
  if (failure.outcome != FLEX_DONE) return failure;
  if ((record->have & FLEX_HAVE_ACCELERATION) && !record->inputs_changed) return failure;

  // inputs that go on as they were change nothing but the rates
  flex_inputs_evaluate(&plant->inputs, record->time, 0.0, plant->u1);
  record->have &= ~(FLEX_HAVE_FIRST_RATES | FLEX_HAVE_SECOND_RATES);
  record->inputs_changed = 0;
  if (record->have & FLEX_HAVE_ACCELERATION) {
    int is_ahead = record->integrator.is_ahead;
    if (is_ahead ? flex_integrator_foresaw(&plant->integrator, plant->u, plant->u1) : go_on(plant, plant->u1)) return failure;
  }

  // inputs that jump: a new acceleration, and new modes of friction
  memcpy(plant->u, plant->u1, (size_t)plant->inputs.count * sizeof(real));
  int stopped = 0;
  flex_outcome outcome = accelerate(plant, record->integrator.modes_are_held, &stopped);
  if (outcome != FLEX_DONE) record->inputs_changed = 1;
  return outcome_now(plant, outcome, 0.0);
}

flex_failure flex_plant_need_admissible(flex_plant *plant) {
  double margin = 0.0;
  flex_failure failure = flex_plant_need_acceleration(plant);
  if (failure.outcome != FLEX_DONE) return failure;
  if (flex_margin(&plant->equations, plant->integrator.y, plant->u, &margin))
    return outcome_now(plant, FLEX_NOT_FINITE, 0.0);
  return outcome_now(plant, margin >= plant->model->minimum_margin ? FLEX_DONE : FLEX_TOO_SINGULAR, margin);
}

flex_failure flex_plant_begin(flex_plant *plant) {
  flex_failure failure = flex_plant_need_acceleration(plant);
  if (failure.outcome == FLEX_DONE) plant->record->is_moving = 1;
  return failure;
}

flex_failure flex_plant_advance(flex_plant *plant, double t0, double t1) {
  flex_plant_record *record = plant->record;

  // the importer's time may differ from ours by a rounding
  for (int i = 0; i < plant->inputs.count; i++)
    if (plant->inputs.base[i] == record->time) plant->inputs.base[i] = t0;
  record->time = t0;
  flex_plant_set_clock(plant);

  // an event that the importer hasn't handled
  int stopped = 0;
  flex_failure failure = record->integrator.at_event ? flex_plant_settle(plant, 0, &stopped) : flex_plant_need_acceleration(plant);
  if (failure.outcome != FLEX_DONE) return failure;

  // where the integrator fails, what it has reached is kept
  memcpy(plant->previous_u, plant->u, (size_t)plant->inputs.count * sizeof(real));
  failure = flex_integrator_advance(&plant->integrator, t0, t1);
  if (failure.time > t0) {
    record->time = failure.time;
    flex_inputs_evaluate(&plant->inputs, record->time, 0.0, plant->u);
    record->have = (record->have & ~POINT) | FLEX_HAVE_ACCELERATION;
  }
  return failure;
}

flex_failure flex_plant_need_outputs(flex_plant *plant) {
  const flex_integrator *integrator = &plant->integrator;
  if (flex_plant_has(plant, FLEX_HAVE_OUTPUTS)) return outcome_now(plant, FLEX_DONE, 0.0);
  flex_failure failure = flex_plant_need_acceleration(plant);
  // whoever asked for rates of the last outputs gets those of these along with them: together they cost less
  if (plant->model->rates_share && plant->rates_come_along && failure.outcome == FLEX_DONE) flex_plant_need_rates(plant, 1);
  plant->rates_come_along = 0;
  if (failure.outcome != FLEX_DONE || (plant->record->have & FLEX_HAVE_OUTPUTS)) return failure;
  const real *const arguments[] = {integrator->y, integrator->v, integrator->a, plant->u, plant->d};
  if (flex_call(&plant->equations, &plant->model->outputs, 5, arguments, plant->outputs) ||
      !flex_all_finite(plant->outputs, plant->model->n_outputs))
    return outcome_now(plant, FLEX_NOT_FINITE, 0.0);
  plant->record->have |= FLEX_HAVE_OUTPUTS;
  return failure;
}

// M x = -(rate of the residual without x), x being jerk or snap, which then adds its part to the rates of the outputs
static int solve_rate(flex_plant *plant, real *x, real *rates) {
  const flex_model *model = plant->model;
  flex_hold(&plant->equations, x);
  flex_cholesky_solve(model->n, plant->integrator.mass_factor, x);
  for (int i = 0; i < model->n; i++) x[i] = -x[i];
  flex_add_acceleration(model, plant->acceleration_entries, x, rates);
  return !flex_all_finite(x, model->n + model->n_outputs);
}

static int call_rates(flex_plant *plant, const flex_function *function, real *result) {
  const flex_integrator *g = &plant->integrator;
  const real *const arguments[] = {g->y, g->v, g->a, plant->u, plant->u1, plant->d, plant->jerk, plant->u2};
  real *w = plant->equations.w;
  plant->equations.w = plant->shared;
  int refused = flex_call(&plant->equations, function, 8, arguments, result);
  plant->equations.w = w;
  return refused;
}

// mass matrix and outputs, which first rates may bring along
static void take_along(flex_plant *plant) {
  const flex_model *model = plant->model;
  flex_integrator *g = &plant->integrator;
  size_t n = (size_t)model->n, outputs = (size_t)model->n_outputs;
  const real *mass = plant->acceleration_entries + model->n_acceleration_terms;
  memcpy(plant->outputs, mass + n * n, outputs * sizeof(real));
  if (flex_all_finite(plant->outputs, model->n_outputs)) plant->record->have |= FLEX_HAVE_OUTPUTS;
  if (n == 0 || g->record->is_factored) return;
  memcpy(g->mass_factor, mass, n * n * sizeof(real));
  flex_hold_mass(&plant->equations, g->mass_factor);
  g->record->is_factored = flex_cholesky_factor(model->n, g->mass_factor) == 0;
}

static flex_outcome first_rates(flex_plant *plant) {
  int refused = call_rates(plant, &plant->model->motion_rate1, plant->jerk);
  if (plant->model->rates_share && !refused) take_along(plant);
  flex_outcome outcome = flex_integrator_factor(&plant->integrator, plant->u);
  if (outcome != FLEX_DONE) return outcome;
  return solve_rate(plant, plant->jerk, plant->first_rates) || refused ? FLEX_NOT_FINITE : FLEX_DONE;
}

static int second_rates(flex_plant *plant) {
  int refused = call_rates(plant, &plant->model->motion_rate2, plant->snap);
  return solve_rate(plant, plant->snap, plant->second_rates) || refused;
}

flex_failure flex_plant_need_rates(flex_plant *plant, int order) {
  flex_plant_record *record = plant->record;
  plant->rates_come_along = 1;
  if (flex_plant_has(plant, FLEX_HAVE_FIRST_RATES | (order > 1 ? FLEX_HAVE_SECOND_RATES : 0)))
    return outcome_now(plant, FLEX_DONE, 0.0);
  flex_failure failure = flex_plant_need_acceleration(plant);
  if (failure.outcome != FLEX_DONE) return failure;
  flex_inputs_rates(&plant->inputs, record->time, plant->u1, plant->u2);
  for (int i = 0; i < plant->inputs.count; i++) {
    real pace = plant->integrator.stages.pace;
    plant->u1[i] = flex_own_rate(plant->u1[i], pace);
    plant->u2[i] = flex_own_rate(flex_own_rate(plant->u2[i], pace), pace);
  }

  // jerk and rates of the outputs, then snap and their second rates
  if (!(record->have & FLEX_HAVE_FIRST_RATES)) {
    flex_outcome outcome = first_rates(plant);
    if (outcome != FLEX_DONE) return outcome_now(plant, outcome, 0.0);
    record->have |= FLEX_HAVE_FIRST_RATES;
  }
  if (order > 1 && !(record->have & FLEX_HAVE_SECOND_RATES)) {
    if (second_rates(plant)) return outcome_now(plant, FLEX_NOT_FINITE, 0.0);
    record->have |= FLEX_HAVE_SECOND_RATES;
  }
  return failure;
}

/* The states of an FMU for model exchange are unknowns of first order of the solver, see exchange.h: what the FMU returns stands in
 * the place of generated functions. Its error is within the tolerance relative to each state's present size, and at least to a
 * hundredth of its nominal value. */
#include "exchange.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "elementary.h"
#include "friction.h"
#include "integration_step.h"
#include "plant.h"

/* statuses of FMI; so many states make wide registers pay */
enum { WARNING = 1, DISCARD = 2, WIDE = 8 };

/* an event is found when an indicator is this much nearer to zero than the solver asks for: FMUs scale theirs as they like */
#define MAGNIFIED 1024.0

/* size of a state at zero, relative to its nominal value */
#define NOMINAL_SHARE 0.01

// time, inputs that aren't held, and states
static int set_point(flex_exchange *e, double time, const double *x) {
  typedef int (*fmi2_call)(void *, const unsigned *, size_t, const double *);
  typedef int (*fmi3_call)(void *, const unsigned *, size_t, const double *, size_t);
  int status = e->set_time(*e->component, time);
  for (size_t g = 0; g < e->polynomials_count && status <= WARNING; g++) {
    const flex_exchange_polynomials *u = e->polynomials + g;
    for (size_t k = 0; k < u->count; k++) {
      u->values[k] = 0.0;
      for (size_t i = u->powers; i-- > 0;) u->values[k] = u->values[k] * (time - u->begin) + u->coefficients[i * u->count + k];
    }
    if (e->is_fmi3)
      status = ((fmi3_call)e->set_real)(*e->component, u->references, u->references_count, u->values, u->count);
    else
      status = ((fmi2_call)e->set_real)(*e->component, u->references, u->references_count, u->values);
  }
  if (e->n > 0 && status <= WARNING) status = e->set_states(*e->component, x, e->n);
  return e->status = status;
}

// rates or indicators at a point; 1 where the FMU discards them. One that has failed is left alone
static int read_at(flex_exchange *e, const real *const *point, int (*get)(void *, double *, size_t), size_t count, double *values) {
  if (e->status > DISCARD) return 1;
  if (count > 0 && set_point(e, point[3][0], point[1]) <= WARNING) e->status = get(*e->component, values, count);
  return e->status > WARNING || !flex_all_finite(values, (int)count);
}

// the work space of these functions is the flex_exchange; their input is the time
static int first_order_residual(const real **arg, real **res, int *iw, real *w, int mem) {
  flex_exchange *e = (void *)w;
  (void)iw, (void)mem;
  if (read_at(e, arg, e->get_rates, e->n, res[0])) return 1;
  for (size_t k = 0; k < e->n; k++) res[0][k] = arg[2][k] - res[0][k];
  return 0;
}

static int unit_mass(const real **arg, real **res, int *iw, real *w, int mem) {
  size_t n = ((flex_exchange *)(void *)w)->n;
  (void)arg, (void)iw, (void)mem;
  memset(res[0], 0, n * n * sizeof(real));
  for (size_t k = 0; k < n; k++) res[0][k * n + k] = 1.0;
  return 0;
}

// M = 1, D = -derivatives of the rates with respect to the states, K = 0
static int first_order_jacobian(const real **arg, real **res, int *iw, real *w, int mem) {
  typedef int (*fmi2_call)(void *, const unsigned *, size_t, const unsigned *, size_t, const double *, double *);
  typedef int (*fmi3_call)(void *, const unsigned *, size_t, const unsigned *, size_t, const double *, size_t, double *, size_t);
  flex_exchange *e = (void *)w;
  size_t n = e->n, r = e->references;
  real *damping = res[0] + n * n, *seed = damping + n * n;
  unit_mass(arg, res, iw, w, mem);
  memset(seed, 0, n * n * sizeof *seed);
  if (e->status > DISCARD || set_point(e, arg[3][0], arg[1]) > WARNING) return 1;
  for (size_t k = 0; k < n && e->status <= WARNING; k++) {
    real *column = damping + k * n;
    seed[k] = 1.0;
    if (e->is_fmi3)
      e->status = ((fmi3_call)e->directional)(*e->component, e->unknown, r, e->known, r, seed, n, column, n);
    else
      e->status = ((fmi2_call)e->directional)(*e->component, e->unknown, r, e->known, r, seed, column);
    seed[k] = 0.0;
    for (size_t i = 0; i < n; i++) column[i] = -column[i];
  }
  return e->status > WARNING;
}

// domains are z > 0 and z <= 0 (FMI 2.0.4, section 3.1.1): zero counts as beyond it
static int indicator_numbers(const real **arg, real **res, int *iw, real *w, int mem) {
  flex_exchange *e = (void *)w;
  (void)iw, (void)mem;
  int refused = read_at(e, arg, e->get_indicators, e->m, res[0]);
  for (size_t k = 0; k < e->m; k++) res[0][k] = res[0][k] == 0.0 ? -DBL_MIN : MAGNIFIED * res[0][k];
  return refused;
}

static int any_pose(const real **arg, real **res, int *iw, real *w, int mem) {
  (void)arg, (void)iw, (void)w, (void)mem;
  res[0][0] = 1.0;
  return 0;
}

// derived parameters: one for the sides of all events, nominal values
static flex_model describe(size_t n, size_t m, int has_jacobian, const flex_event *events) {
  flex_model model = {.n = (int)n, .n_first = (int)n, .n_inputs = 1, .max_input_order = 1, .n_derived = (int)n + 1,
                      .n_events = (int)m, .events = events, .is_damped = 1, .sizes_grow = 1,
                      .residual = {.call = first_order_residual}, .mass_matrix = {.call = unit_mass},
                      .event_numbers = {.call = indicator_numbers}, .singularity = {.call = any_pose}};
  if (has_jacobian) model.jacobian.call = first_order_jacobian;
  return model;
}

size_t flex_exchange_size(size_t n, size_t m) {
  flex_model model = describe(n, m, 0, NULL);
  flex_arena arena = {NULL, 0};
  flex_take(&arena, sizeof model);
  flex_take(&arena, m * sizeof(flex_event));
  return arena.used + flex_plant_size(&model);
}

// the input, and an error norm in which each state has its present size
static void prepare(flex_exchange *e) {
  flex_plant *plant = e->plant;
  e->status = e->ends = 0;
  flex_inputs_set(&plant->inputs, 0, e->time, e->time);
  flex_inputs_set_derivative(&plant->inputs, 0, e->time, 1, 1.0);
  plant->u[0] = e->time;
  for (size_t k = 0; k < e->n; k++) {
    double size = NOMINAL_SHARE * plant->d[1 + k] + fabs(plant->integrator.v[k]);
    plant->scale[e->n + k] = 1.0 / (size * size);
  }
  plant->record->integrator.scale = plant->scale[2 * e->n] = sqrt(fmax(1.0, (double)e->n));
}

// the FMU at the end of a step, which may be an event
static void complete(flex_integrator *integrator, double time) {
  typedef int (*fmi2_call)(void *, int, int *, int *);
  typedef int (*fmi3_call)(void *, bool, bool *, bool *);
  flex_exchange *e = (void *)integrator->stages.equations->w;
  int enters = 0;
  e->time = time;
  if (set_point(e, time, integrator->v) <= WARNING && e->completed != NULL && e->is_fmi3) {
    bool enter = false, end = false;
    e->status = ((fmi3_call)e->completed)(*e->component, e->no_rollback != 0, &enter, &end);
    enters = enter, e->ends = end;
  } else if (e->status <= WARNING && e->completed != NULL) {
    e->status = ((fmi2_call)e->completed)(*e->component, e->no_rollback, &enters, &e->ends);
  }
  integrator->record->at_event |= enters || e->ends || e->status > WARNING;
}

static void create(flex_exchange *e) {
  flex_arena arena = {e->memory, 0};
  flex_model *model = flex_take(&arena, sizeof *model);
  flex_event *events = flex_take(&arena, e->m * sizeof *events);
  *model = describe(e->n, e->m, e->directional != NULL, events);
  flex_plant *plant = e->plant = flex_plant_create(model, arena.block + arena.used);
  plant->equations.w = (void *)e;
  plant->equations.has_lanes &= e->n >= WIDE;
  plant->integrator.stops_at_events = 1;
  plant->integrator.completed = complete;
  flex_integrator_use(&plant->integrator, flex_find_method(FLEX_RADAU_3, e->tolerance, 1, 1), e->tolerance);
}

int flex_exchange_begin(flex_exchange *e, int anew) {
  if (e->plant == NULL) create(e);
  flex_plant *plant = e->plant;
  flex_integrator *integrator = &plant->integrator;
  double *nominal = plant->d + 1, *z = plant->equations.crossings;
  if (anew && e->n > 0) {
    e->status = e->get_states(*e->component, integrator->v, e->n);
    if (e->status <= WARNING) e->status = e->get_nominals(*e->component, nominal, e->n);
    if (e->status > WARNING) return EXCHANGE_FAILED;
  }
  for (size_t k = 0; k < e->n; k++)
    if (!(nominal[k] > 0.0)) nominal[k] = 1.0;
  prepare(e);
  if (anew) flex_integrator_start(integrator);
  integrator->record->history_step = 0.0;
  memset(integrator->a, 0, e->n * sizeof *integrator->a);
  int refused = flex_step_accelerate_present(integrator, plant->u) != FLEX_DONE;
  // the domain in which each indicator is
  const real *const point[] = {integrator->y, integrator->v, integrator->a, plant->u};
  refused = refused || read_at(e, point, e->get_indicators, e->m, z);
  for (size_t k = 0; k < e->m; k++) flex_set_mode(&plant->equations, (int)k, z[k] > 0.0 ? FLEX_FORWARD : FLEX_BACKWARD);
  if (!refused) set_point(e, e->time, integrator->v);
  return e->status > DISCARD ? EXCHANGE_FAILED : refused ? EXCHANGE_STUCK : EXCHANGE_REACHED;
}

int flex_exchange_advance(flex_exchange *e, double bound) {
  flex_integrator *integrator = &((flex_plant *)e->plant)->integrator;
  prepare(e);
  flex_outcome outcome = flex_integrator_advance(integrator, e->time, bound).outcome;
  int is_event = integrator->record->at_event;
  integrator->record->at_event = 0;
  if (e->status > (outcome == FLEX_DONE ? WARNING : DISCARD)) return EXCHANGE_FAILED;
  return outcome != FLEX_DONE ? EXCHANGE_STUCK : e->ends ? EXCHANGE_ENDS : is_event ? EXCHANGE_EVENT : EXCHANGE_REACHED;
}

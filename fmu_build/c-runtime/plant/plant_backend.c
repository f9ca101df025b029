/* A plant behind the FMI layer; for model exchange as a system dx/dt = f(t, x, u), x = [y, v] without those that are no states. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "events.h"
#include "model_exchange.h"
#include "variables.h"

/* smallest relative tolerance: below it ROUNDING_ERROR of the integrator decides about the steps of every method */
#define LEAST_TOLERANCE 1e-12

const char *flex_backend_guid(void) {
  return flex_the_model.guid;
}

int flex_backend_has_model_exchange(void) {
  return 1;
}

size_t flex_backend_size(void) {
  flex_arena arena = {NULL, 0};
  flex_take(&arena, sizeof(plant_backend));
  return arena.used + flex_plant_size(&flex_the_model);
}

flex_backend *flex_backend_create(void *memory) {
  flex_arena arena = {memory, 0};
  plant_backend *whole = flex_take(&arena, sizeof *whole);
  flex_plant *plant = flex_plant_create(&flex_the_model, arena.block + arena.used);
  whole->plant = plant;
  whole->base.state = plant->record;
  whole->base.state_size = plant->state_size;
  whole->base.time = &plant->record->time;
  whole->base.message = plant->message;
  whole->base.n_inputs = (unsigned)flex_the_model.n_inputs;
  whole->base.n_settable = (unsigned)(flex_the_model.n_inputs + flex_the_model.n_parameters);
  whole->base.n_outputs = (unsigned)flex_the_model.n_outputs;
  whole->base.max_input_order = flex_the_model.max_input_order;
  return &whole->base;
}

void flex_backend_reset(flex_backend *backend) {
  flex_plant_reset(plant_of(backend));
}

void flex_backend_restored(flex_backend *backend) {
  flex_plant_restored(plant_of(backend));
}

void flex_backend_set_start_time(flex_backend *backend, double time) {
  flex_plant_set_start_time(plant_of(backend), time);
}

double flex_backend_set_tolerance(flex_backend *backend, double tolerance) {
  return plant_of(backend)->record->tolerance = tolerance < LEAST_TOLERANCE ? LEAST_TOLERANCE : tolerance;
}

int flex_backend_begin(flex_backend *backend) {
  return flex_explain(plant_of(backend), "initialisation", flex_plant_begin(plant_of(backend)));
}

int flex_backend_advance(flex_backend *backend, double t0, double t1, int *event) {
  flex_plant *plant = plant_of(backend);
  plant->integrator.stops_at_events = event != NULL;
  int is_refused = flex_explain(plant, "integration", flex_plant_advance(plant, t0, t1));
  if (event) *event = plant->record->integrator.at_event;
  return is_refused;
}

// what importers read by dozens in every step: outputs that are there are a table, the rest is computed or refused one by one
int flex_backend_get_reals(flex_backend *backend, const unsigned *index, size_t count, double *value) {
  flex_plant *plant = plant_of(backend);
  unsigned first = flex_first_output(plant->model), n = (unsigned)plant->model->n_outputs;
  const double *outputs = plant->outputs;
  int is_there = flex_plant_has(plant, FLEX_HAVE_OUTPUTS);
  for (size_t i = 0; i < count; i++) {
    if (is_there && index[i] - first < n) {
      value[i] = outputs[index[i] - first];
      continue;
    }
    if (flex_get_real(plant, index[i], &value[i])) return 1;
    is_there = flex_plant_has(plant, FLEX_HAVE_OUTPUTS);
  }
  return 0;
}

int flex_backend_set_real(flex_backend *backend, unsigned index, double value) {
  return flex_set_real(plant_of(backend), index, value);
}

int flex_backend_set_input_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                       const double *value) {
  flex_plant *plant = plant_of(backend);
  unsigned n_inputs = (unsigned)plant->model->n_inputs, highest = (unsigned)plant->model->max_input_order;
  double time = plant->record->time;
  for (size_t i = 0; i < count; i++) {
    int fits = index[i] < n_inputs && (unsigned)order[i] - 1 < highest && value[i] - value[i] == 0.0;
    if (!fits) return flex_refuse_input_derivative(plant, index[i], order[i], value[i]);
    flex_inputs_set_derivative(&plant->inputs, (int)index[i], time, order[i], value[i]);
    if (i == 0) flex_plant_inputs_changed(plant);
  }
  return 0;
}

double flex_backend_input_derivative(flex_backend *backend, unsigned input, int order) {
  const flex_plant *plant = plant_of(backend);
  return flex_inputs_derivative(&plant->inputs, (int)input, plant->record->time, order);
}

int flex_backend_get_output_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                        double *value) {
  flex_plant *plant = plant_of(backend);
  unsigned first = flex_first_output(plant->model), n = (unsigned)plant->model->n_outputs, highest = 0;
  const double *const rates[] = {plant->first_rates, plant->second_rates};
  for (size_t i = 0; i < count; i++) {
    unsigned from_zero = (unsigned)order[i] - 1;
    if (from_zero < highest && index[i] - first < n) {
      value[i] = rates[from_zero][index[i] - first];
      continue;
    }
    if (flex_get_output_derivative(plant, index[i], order[i], &value[i])) return 1;
    highest = (unsigned)order[i] > highest ? (unsigned)order[i] : highest;
  }
  return 0;
}

size_t flex_backend_states(void) {
  return (size_t)(flex_state_coordinates(&flex_the_model) + flex_state_rates(&flex_the_model));
}

// bytes of the states that are coordinates, and of those that are rates, which follow them
static size_t coordinate_size(void) {
  return (size_t)flex_state_coordinates(&flex_the_model) * sizeof(double);
}

static size_t rate_size(void) {
  return (size_t)flex_state_rates(&flex_the_model) * sizeof(double);
}

void flex_backend_set_time(flex_backend *backend, double time) {
  flex_plant *plant = plant_of(backend);
  plant->record->time = time;
  if (!plant->model->has_clock) return;
  flex_plant_set_clock(plant);
  flex_plant_moved(plant);
}

void flex_backend_set_states(flex_backend *backend, const double *x) {
  flex_plant *plant = plant_of(backend);
  flex_integrator *integrator = &plant->integrator;
  size_t size = (size_t)plant->model->n * sizeof(double);
  memcpy(integrator->y, x, coordinate_size());
  memcpy(integrator->v, x + flex_state_coordinates(plant->model), rate_size());
  memset(integrator->y_rest, 0, size);
  memset(integrator->v_rest, 0, size);

  // the acceleration shall not depend on what was evaluated before, not even by its last digit
  memset(integrator->a, 0, size);
  flex_plant_moved(plant);
}

int flex_backend_get_states(flex_backend *backend, double *x) {
  flex_plant *plant = plant_of(backend);
  if (flex_explain(plant, "computing the states", flex_plant_need_start(plant))) return 1;
  memcpy(x, plant->integrator.y, coordinate_size());
  memcpy(x + flex_state_coordinates(plant->model), plant->integrator.v, rate_size());
  return 0;
}

int flex_backend_get_state_rates(flex_backend *backend, double *rates) {
  flex_plant *plant = plant_of(backend);
  if (flex_explain(plant, "computing state derivatives", flex_plant_need_admissible(plant))) return 1;
  memcpy(rates, plant->integrator.v, coordinate_size());
  memcpy(rates + flex_state_coordinates(plant->model), plant->integrator.a, rate_size());
  return 0;
}

size_t flex_backend_indicators(void) {
  return (size_t)flex_switches(&flex_the_model);
}

int flex_backend_get_indicators(flex_backend *backend, double *indicators) {
  return flex_explain(plant_of(backend), "computing event indicators", flex_plant_indicators(plant_of(backend), indicators));
}

int flex_backend_handle_event(flex_backend *backend, int is_exchange, int *states_changed, double *next) {
  flex_plant *plant = plant_of(backend);
  *states_changed = 0;
  *next = HUGE_VAL;
  if (!is_exchange && !plant->record->integrator.at_event) return 0;
  flex_failure failure = flex_plant_settle(plant, is_exchange, states_changed);
  if (failure.outcome == FLEX_DONE && is_exchange)
    *next = flex_events_next(&plant->integrator, plant->u, plant->record->time);
  return flex_explain(plant, "event", failure);
}

int flex_backend_has_event(flex_backend *backend) {
  return flex_plant_has_event(plant_of(backend));
}

double flex_backend_state_nominal(size_t index) {
  return flex_the_model.state_nominals ? flex_the_model.state_nominals[index] : 1.0;
}

int flex_backend_check_point(flex_backend *backend) {
  return flex_explain(plant_of(backend), "end of an integrator step", flex_plant_need_admissible(plant_of(backend)));
}

void flex_backend_summarise(flex_backend *backend, char *text, size_t size) {
  const flex_plant_record *record = plant_of(backend)->record;
  snprintf(text, size,
           "%lld steps, %lld rejected, %lld evaluations of the equations, %lld Newton iterations, %lld factorisations",
           record->integrator.steps, record->integrator.rejections, record->stages.evaluations, record->stages.iterations,
           record->stages.matrix.factorisations);
}

/* A discrete-time block behind the FMI layer; reals are numbered inputs | parameters | outputs. */
#include <limits.h>
#include <stdio.h>

#include "backend.h"
#include "block.h"

/* integers: how many samples are completed */
enum { FLEX_SAMPLES, FLEX_N_INTEGERS };

typedef struct {
  flex_backend base;
  flex_block *block;
} block_backend;

static flex_block *block_of(const flex_backend *backend) {
  return ((const block_backend *)backend)->block;
}

const char *flex_backend_guid(void) {
  return flex_the_block.guid;
}

int flex_backend_has_model_exchange(void) {
  return 0;
}

size_t flex_backend_size(void) {
  flex_arena arena = {NULL, 0};
  flex_take(&arena, sizeof(block_backend));
  return arena.used + flex_block_size(&flex_the_block);
}

static int tick(flex_backend *backend) {
  return flex_block_tick(block_of(backend));
}

flex_backend *flex_backend_create(void *memory) {
  flex_arena arena = {memory, 0};
  block_backend *whole = flex_take(&arena, sizeof *whole);
  flex_block *block = flex_block_create(&flex_the_block, arena.block + arena.used);
  whole->block = block;
  whole->base.state = block->record;
  whole->base.state_size = block->state_size;
  whole->base.time = &block->record->time;
  whole->base.message = block->message;
  whole->base.tick = tick;
  whole->base.n_inputs = (unsigned)flex_the_block.n_inputs;
  whole->base.n_settable = (unsigned)(flex_the_block.n_inputs + flex_the_block.n_parameters);
  whole->base.n_outputs = (unsigned)flex_the_block.n_outputs;
  return &whole->base;
}

void flex_backend_reset(flex_backend *backend) {
  flex_block_reset(block_of(backend));
}

void flex_backend_restored(flex_backend *backend) {
  (void)backend;
}

void flex_backend_set_start_time(flex_backend *backend, double time) {
  flex_block_set_start_time(block_of(backend), time);
}

double flex_backend_set_tolerance(flex_backend *backend, double tolerance) {
  (void)backend;
  return tolerance;
}

int flex_backend_begin(flex_backend *backend) {
  return flex_block_begin(block_of(backend));
}

int flex_backend_advance(flex_backend *backend, double t0, double t1, int *event) {
  (void)event;
  return flex_block_advance(block_of(backend), t0, t1);
}

int flex_backend_handle_event(flex_backend *backend, int is_exchange, int *states_changed, double *next) {
  return (void)backend, (void)is_exchange, (void)states_changed, (void)next, 0;
}

static int is_known(flex_block *block, unsigned index) {
  const flex_block_model *model = block->model;
  return !flex_refuse_reference(block->message, index, model->n_inputs + model->n_parameters + model->n_outputs);
}

static int get_real(flex_block *block, unsigned index, double *value) {
  unsigned m = (unsigned)block->model->n_inputs, settable = m + (unsigned)block->model->n_parameters;
  if (!is_known(block, index)) return 1;
  if (index < m) {
    flex_inputs_evaluate(&block->inputs, block->record->time, 0.0, block->u);
    double shown = block->u[index];
    if (flex_refuse_input(block->message, &block->model->input_variables[index], block->record->time, shown)) return 1;
    *value = shown;
  } else if (index < settable) {
    *value = block->p[index - m];
  } else {
    return flex_block_output(block, (int)(index - settable), value);
  }
  return 0;
}

int flex_backend_get_reals(flex_backend *backend, const unsigned *index, size_t count, double *value) {
  for (size_t i = 0; i < count; i++)
    if (get_real(block_of(backend), index[i], &value[i])) return 1;
  return 0;
}

static int set_parameter(flex_block *block, unsigned index, double value) {
  const flex_variable *variable = &block->model->parameter_variables[index];
  if (block->record->is_moving && !variable->tunable)
    return flex_refuse(block->message, "parameter %s is fixed after initialisation; reset the instance to change it",
                       variable->name);
  if (flex_refuse_value(block->message, variable, value)) return 1;
  block->p[index] = value;
  flex_block_changed(block);
  return 0;
}

int flex_backend_set_real(flex_backend *backend, unsigned index, double value) {
  flex_block *block = block_of(backend);
  const flex_block_model *model = block->model;
  unsigned m = (unsigned)model->n_inputs, settable = backend->n_settable;
  if (!is_known(block, index)) return 1;
  if (index >= settable)
    return flex_refuse(block->message, "%s is an output, it cannot be set", model->output_variables[index - settable].name);
  if (index >= m) return set_parameter(block, index - m, value);
  if (flex_refuse_value(block->message, &model->input_variables[index], value)) return 1;
  flex_inputs_set(&block->inputs, (int)index, block->record->time, value);
  flex_block_input_set(block);
  return 0;
}

int flex_backend_get_integer(flex_backend *backend, unsigned index, int *value) {
  flex_block *block = block_of(backend);
  if (index != FLEX_SAMPLES)
    return flex_refuse(block->message, "value reference %u of an integer variable is unknown; there are %d", index,
                       FLEX_N_INTEGERS);
  *value = block->record->next > INT_MAX ? INT_MAX : (int)block->record->next;
  return 0;
}

int flex_backend_set_integer(flex_backend *backend, unsigned index, int value) {
  (void)value;
  return flex_refuse(block_of(backend)->message, "integer variable %u counts samples, it cannot be set", index);
}

static int set_input_derivative(flex_block *block, unsigned index, int order, double value) {
  const flex_block_model *model = block->model;
  if (index >= (unsigned)model->n_inputs)
    return flex_refuse(block->message, "value reference %u is no input, its derivatives cannot be set", index);
  if (flex_refuse_derivative(block->message, model->input_variables[index].name, order, model->max_input_order, value))
    return 1;
  flex_inputs_set_derivative(&block->inputs, (int)index, block->record->time, order, value);
  flex_block_input_set(block);
  return 0;
}

int flex_backend_set_input_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                       const double *value) {
  for (size_t i = 0; i < count; i++)
    if (set_input_derivative(block_of(backend), index[i], order[i], value[i])) return 1;
  return 0;
}

int flex_backend_max_input_order(void) {
  return flex_the_block.max_input_order;
}

double flex_backend_input_derivative(const flex_backend *backend, unsigned input, int order) {
  const flex_block *block = block_of(backend);
  return flex_inputs_derivative(&block->inputs, (int)input, block->record->time, order);
}

int flex_backend_get_output_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                        double *value) {
  (void)index, (void)order, (void)value;
  if (count == 0) return 0;
  return flex_refuse(block_of(backend)->message, "outputs are held between samples and jump there, they have no derivatives");
}

int flex_backend_differentiate(flex_backend *backend, const flex_direction *direction) {
  (void)direction;
  return flex_refuse(block_of(backend)->message, "this FMU provides no directional derivatives, as its model description says");
}

void flex_backend_summarise(const flex_backend *backend, char *text, size_t size) {
  snprintf(text, size, "%lld samples", block_of(backend)->record->next);
}

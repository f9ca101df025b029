/* A discrete-time block behind the FMI layer: it samples at its instants and holds its outputs in between. Reals are numbered
 * inputs | parameters | outputs.
 *
 * A sample is due while the present time is its instant. It is completed, with the inputs as they are then, when time goes
 * on. Until then its outputs come from the next states, and where they depend on inputs, they need the inputs of this
 * instant: they hold the last completed sample until an input is set here, and follow the inputs from then on. Inputs with
 * derivatives are known here already, from their polynomials. Importers that set inputs before they read outputs so get this
 * sample, as often as they ask; those that read first get the sample before, never one of new states and old inputs. Outputs
 * that depend on states alone are those of the due sample at once.
 *
 * All numeric state lies in one piece of memory without pointers, so that saving and restoring it is a copy. */
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "backend.h"
#include "block_model.h"
#include "clock.h"
#include "elementary.h"
#include "inputs.h"
#include "refusal.h"

/* no importer can stop a communication step that has begun: so many samples take some seconds */
#ifndef FLEX_MAX_SAMPLES
#define FLEX_MAX_SAMPLES 1e8
#endif

/* integers: how many samples are completed */
enum { FLEX_SAMPLES, FLEX_N_INTEGERS };

/* the scalars of the numeric state */
typedef struct {
  double time, start_time; /* [s] */
  long long next;          /* index of the first sample that is not completed; all before it are */
  int is_moving;           /* 1 = initialisation is over */
  int is_due;              /* 1 = the present time is the instant of that sample */
  int is_open;             /* 1 = the inputs of the present time are known: one has been set or follows its polynomial */
  int is_taken;            /* 1 = due_y and next_x are those of that sample, for the present inputs and parameters */
} flex_block_record;

typedef struct {
  flex_backend base; /* whose state begins with the record */
  flex_block_record *record;

  /* numeric state */
  double *p, *x, *next_x, *due_y;
  double *y; /* outputs of the last completed sample, of the initial inputs before the first */
  flex_inputs inputs;

  /* scratch */
  double *u, *w;
  int *iw;
  const double **arg;
  double **res;

  char message[FLEX_MESSAGE_SIZE]; /* why the last call was refused */
} flex_block;

static flex_block *block_of(flex_backend *backend) {
  return (flex_block *)backend;
}

const char *flex_backend_guid(void) {
  return flex_the_block.guid;
}

// pieces of an instance in memory; the numeric state first
static void take(flex_block *block, flex_arena *arena) {
  const flex_block_model *model = &flex_the_block;
  const flex_function *sample = &model->sample;
  size_t n = (size_t)model->n_states;

  // numeric state
  size_t begin = arena->used;
  block->record = flex_take(arena, sizeof *block->record);
  block->p = flex_take_doubles(arena, (size_t)model->n_parameters);
  block->x = flex_take_doubles(arena, n);
  block->next_x = flex_take_doubles(arena, n);
  block->due_y = flex_take_doubles(arena, (size_t)model->n_outputs);
  block->y = flex_take_doubles(arena, (size_t)model->n_outputs);
  flex_inputs_take(&block->inputs, model->n_inputs, model->max_input_order, arena);
  block->base.state_size = arena->used - begin;

  // scratch
  block->u = flex_take_doubles(arena, (size_t)model->n_inputs);
  block->w = flex_take_doubles(arena, (size_t)sample->n_w);
  block->iw = flex_take_ints(arena, (size_t)sample->n_iw);
  block->arg = flex_take(arena, (size_t)sample->n_arg * sizeof *block->arg);
  block->res = flex_take(arena, (size_t)sample->n_res * sizeof *block->res);
}

size_t flex_backend_size(void) {
  flex_block block;
  flex_arena arena = {NULL, 0};
  flex_take(&arena, sizeof block);
  take(&block, &arena);
  return arena.used;
}

void flex_backend_reset(flex_backend *backend) {
  const flex_block_model *model = &flex_the_block;
  flex_block *block = block_of(backend);
  memset(block->record, 0, backend->state_size);
  for (int i = 0; i < model->n_parameters; i++) block->p[i] = model->parameter_variables[i].start;
  for (int i = 0; i < model->n_states; i++) block->x[i] = model->start_states[i];
  for (int i = 0; i < model->n_inputs; i++) flex_inputs_set(&block->inputs, i, 0.0, model->input_variables[i].start);
  block->message[0] = '\0';
}

void flex_backend_set_start_time(flex_backend *backend, double time) {
  flex_block *block = block_of(backend);
  block->record->time = block->record->start_time = time;
  for (int i = 0; i < block->inputs.count; i++) block->inputs.base[i] = time;
  block->record->is_taken = 0;
}

// index of the first number that is not finite, or -1
static int first_bad(const double *values, int count) {
  for (int i = 0; i < count; i++)
    if (!isfinite(values[i])) return i;
  return -1;
}

// outputs and next states for the inputs at the present time, unless they are known
static int evaluate(flex_block *block) {
  const flex_block_model *model = &flex_the_block;
  double time = block->record->time;
  if (block->record->is_taken) return 0;
  flex_inputs_evaluate(&block->inputs, time, 0.0, block->u);
  for (int i = 0; i < model->n_inputs; i++)
    if (flex_refuse_input(block->message, &model->input_variables[i], time, block->u[i])) return 1;

  // generated code may use what is behind arguments and results for itself
  block->arg[0] = block->x, block->arg[1] = block->u, block->arg[2] = block->p;
  block->res[0] = block->due_y, block->res[1] = block->next_x;
  if (model->sample.call(block->arg, block->res, block->iw, block->w, 0))
    return flex_refuse(block->message, "sampling at %.9g s: the equations cannot be evaluated; check inputs", time);
  block->record->is_taken = 1;
  return 0;
}

static int refuse_output(flex_block *block, int index) {
  return flex_refuse(block->message, "sampling at %.9g s: %s is %g; check inputs and parameters", block->record->time,
                     flex_the_block.output_variables[index].name, block->due_y[index]);
}

// the outputs of this sample are those to hold; no NaN travels on silently
static int take_sample(flex_block *block) {
  const flex_block_model *model = &flex_the_block;
  if (evaluate(block)) return 1;
  int bad = first_bad(block->due_y, model->n_outputs);
  if (bad >= 0) return refuse_output(block, bad);
  bad = first_bad(block->next_x, model->n_states);
  if (bad >= 0)
    return flex_refuse(block->message, "sampling at %.9g s: state %d becomes %g; check inputs and parameters",
                       block->record->time, bad + 1, block->next_x[bad]);
  memcpy(block->y, block->due_y, (size_t)model->n_outputs * sizeof *block->y);
  return 0;
}

// the sample that is due, for good
static int complete_sample(flex_block *block) {
  flex_block_record *record = block->record;
  if (take_sample(block)) return 1;
  memcpy(block->x, block->next_x, (size_t)flex_the_block.n_states * sizeof *block->x);
  record->next++;
  record->is_due = record->is_taken = 0;
  return 0;
}

static double next_instant(const flex_block *block) {
  const flex_block_record *record = block->record;
  return record->start_time + flex_the_block.offset + (double)record->next * flex_the_block.sample_time;
}

// the importer says that the present time is a sample's instant, whose inputs are there or set next
static int tick(flex_backend *backend) {
  flex_block *block = block_of(backend);
  if (!block->record->is_due)
    return flex_refuse(block->message, "the clock ticks at %.9g s next, not at %.9g s", next_instant(block), block->record->time);
  block->record->is_open = 1;
  return 0;
}

flex_backend *flex_backend_create(void *memory) {
  const flex_block_model *model = &flex_the_block;
  flex_arena arena = {memory, 0};
  flex_block *block = flex_take(&arena, sizeof *block);
  flex_backend *base = &block->base;
  take(block, &arena);
  base->state = block->record;
  base->time = &block->record->time;
  base->message = block->message;
  base->tick = tick;
  base->n_inputs = (unsigned)model->n_inputs;
  base->n_settable = (unsigned)(model->n_inputs + model->n_parameters);
  base->n_outputs = (unsigned)model->n_outputs;
  base->max_input_order = model->max_input_order;
  flex_backend_reset(base);
  return base;
}

int flex_backend_begin(flex_backend *backend) {
  flex_block *block = block_of(backend);
  flex_block_record *record = block->record;
  if (take_sample(block)) return 1;
  record->is_moving = record->is_open = 1;
  record->is_due = flex_the_block.offset <= flex_time_slack(0.0, flex_the_block.sample_time);
  record->is_taken = record->is_due;
  return 0;
}

/* an input with derivatives says itself what it is at the end of a step */
static int follows_polynomials(const flex_inputs *inputs) {
  for (int i = 0; i < inputs->count; i++)
    if (inputs->degree[i] > 0) return 1;
  return 0;
}

// after a failure the block stands at the sample that failed
int flex_backend_advance(flex_backend *backend, double t0, double t1, int *event) {
  (void)event;
  flex_block *block = block_of(backend);
  flex_block_record *record = block->record;
  double slack = flex_time_slack(t1, fmin(t1 - t0, flex_the_block.sample_time));

  double samples = (t1 - t0) / flex_the_block.sample_time;
  if (samples > FLEX_MAX_SAMPLES)
    return flex_refuse(block->message, "a communication step of %.6g s has %.3g samples, but may have %.3g; make it shorter",
                       t1 - t0, samples, FLEX_MAX_SAMPLES);

  // the importer's time may differ from ours by a rounding
  for (int i = 0; i < block->inputs.count; i++)
    if (block->inputs.base[i] == record->time) block->inputs.base[i] = t0;
  record->time = t0;
  record->is_open = 1;
  if (record->is_due && complete_sample(block)) return 1;

  // instants within the step, where the inputs are what their polynomials say
  for (double instant = next_instant(block); instant < t1 - slack; instant = next_instant(block)) {
    record->time = instant;
    record->is_due = 1;
    if (complete_sample(block)) return 1;
  }
  record->time = t1;
  record->is_open = follows_polynomials(&block->inputs);
  record->is_due = next_instant(block) <= t1 + slack;
  return 0;
}

int flex_backend_handle_event(flex_backend *backend, int is_exchange, int *states_changed, double *next) {
  return (void)backend, (void)is_exchange, (void)states_changed, (void)next, 0;
}

// an output at the present time: before the first instant that of the start states
static int get_output(flex_block *block, int index, double *value) {
  const flex_block_record *record = block->record;
  int is_known = record->is_due && (record->is_open || !flex_the_block.feeds_through[index]);
  *value = block->y[index];
  if (record->is_moving && !is_known) return 0;
  if (evaluate(block)) return 1;
  if (!isfinite(block->due_y[index])) return refuse_output(block, index);
  *value = block->due_y[index];
  return 0;
}

static int get_real(flex_block *block, unsigned index, double *value) {
  unsigned m = block->base.n_inputs, settable = block->base.n_settable;
  if (flex_refuse_reference(block->message, index, settable + block->base.n_outputs)) return 1;
  if (index < m) {
    flex_inputs_evaluate(&block->inputs, block->record->time, 0.0, block->u);
    double shown = block->u[index];
    if (flex_refuse_input(block->message, &flex_the_block.input_variables[index], block->record->time, shown)) return 1;
    *value = shown;
  } else if (index < settable) {
    *value = block->p[index - m];
  } else {
    return get_output(block, (int)(index - settable), value);
  }
  return 0;
}

int flex_backend_get_reals(flex_backend *backend, const unsigned *index, size_t count, double *value) {
  for (size_t i = 0; i < count; i++)
    if (get_real(block_of(backend), index[i], &value[i])) return 1;
  return 0;
}

static int set_parameter(flex_block *block, unsigned index, double value) {
  const flex_variable *variable = &flex_the_block.parameter_variables[index];
  if (block->record->is_moving && !variable->tunable)
    return flex_refuse(block->message, "parameter %s is fixed after initialisation; reset the instance to change it",
                       variable->name);
  if (flex_refuse_value(block->message, variable, value)) return 1;
  block->p[index] = value;
  block->record->is_taken = 0;
  return 0;
}

int flex_backend_set_real(flex_backend *backend, unsigned index, double value) {
  flex_block *block = block_of(backend);
  const flex_block_model *model = &flex_the_block;
  unsigned m = backend->n_inputs, settable = backend->n_settable;
  if (flex_refuse_reference(block->message, index, settable + backend->n_outputs)) return 1;
  if (index >= settable)
    return flex_refuse(block->message, "%s is an output, it cannot be set", model->output_variables[index - settable].name);
  if (index >= m) return set_parameter(block, index - m, value);
  if (flex_refuse_value(block->message, &model->input_variables[index], value)) return 1;
  flex_inputs_set(&block->inputs, (int)index, block->record->time, value);
  block->record->is_open = 1;
  block->record->is_taken = 0;
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
  const flex_block_model *model = &flex_the_block;
  if (index >= (unsigned)model->n_inputs)
    return flex_refuse(block->message, "value reference %u is no input, its derivatives cannot be set", index);
  if (flex_refuse_derivative(block->message, model->input_variables[index].name, order, model->max_input_order, value))
    return 1;
  flex_inputs_set_derivative(&block->inputs, (int)index, block->record->time, order, value);
  block->record->is_open = 1;
  block->record->is_taken = 0;
  return 0;
}

int flex_backend_set_input_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                       const double *value) {
  for (size_t i = 0; i < count; i++)
    if (set_input_derivative(block_of(backend), index[i], order[i], value[i])) return 1;
  return 0;
}

double flex_backend_input_derivative(flex_backend *backend, unsigned input, int order) {
  const flex_block *block = block_of(backend);
  return flex_inputs_derivative(&block->inputs, (int)input, block->record->time, order);
}

int flex_backend_get_output_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                        double *value) {
  (void)index, (void)order, (void)value;
  if (count == 0) return 0;
  return flex_refuse(block_of(backend)->message, "outputs are held between samples and jump there, they have no derivatives");
}

void flex_backend_summarise(flex_backend *backend, char *text, size_t size) {
  snprintf(text, size, "%lld samples", block_of(backend)->record->next);
}

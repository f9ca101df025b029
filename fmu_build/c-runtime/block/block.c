#include "block.h"

#include <math.h>
#include <string.h>

#include "clock.h"
#include "elementary.h"

/* no importer can stop a communication step that has begun: so many samples take some seconds */
#ifndef FLEX_MAX_SAMPLES
#define FLEX_MAX_SAMPLES 1e8
#endif

// pieces of an instance in memory; the numeric state first
static void take(flex_block *block, const flex_block_model *model, flex_arena *arena) {
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
  block->state_size = arena->used - begin;

  // scratch
  block->u = flex_take_doubles(arena, (size_t)model->n_inputs);
  block->w = flex_take_doubles(arena, (size_t)sample->n_w);
  block->iw = flex_take_ints(arena, (size_t)sample->n_iw);
  block->arg = flex_take(arena, (size_t)sample->n_arg * sizeof *block->arg);
  block->res = flex_take(arena, (size_t)sample->n_res * sizeof *block->res);
}

size_t flex_block_size(const flex_block_model *model) {
  flex_block block;
  flex_arena arena = {NULL, 0};
  flex_take(&arena, sizeof block);
  take(&block, model, &arena);
  return arena.used;
}

flex_block *flex_block_create(const flex_block_model *model, void *memory) {
  flex_arena arena = {memory, 0};
  flex_block *block = flex_take(&arena, sizeof *block);
  take(block, model, &arena);
  block->model = model;
  flex_block_reset(block);
  return block;
}

void flex_block_reset(flex_block *block) {
  const flex_block_model *model = block->model;
  memset(block->record, 0, block->state_size);
  for (int i = 0; i < model->n_parameters; i++) block->p[i] = model->parameter_variables[i].start;
  for (int i = 0; i < model->n_states; i++) block->x[i] = model->start_states[i];
  for (int i = 0; i < model->n_inputs; i++) flex_inputs_set(&block->inputs, i, 0.0, model->input_variables[i].start);
  block->message[0] = '\0';
}

void flex_block_set_start_time(flex_block *block, double time) {
  block->record->time = block->record->start_time = time;
  for (int i = 0; i < block->inputs.count; i++) block->inputs.base[i] = time;
  flex_block_changed(block);
}

void flex_block_changed(flex_block *block) {
  block->record->is_taken = 0;
}

void flex_block_input_set(flex_block *block) {
  block->record->is_open = 1;
  flex_block_changed(block);
}

// index of the first number that is not finite, or -1
static int first_bad(const double *values, int count) {
  for (int i = 0; i < count; i++)
    if (!isfinite(values[i])) return i;
  return -1;
}

// outputs and next states for the inputs at the present time, unless they are known
static int evaluate(flex_block *block) {
  const flex_block_model *model = block->model;
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
                     block->model->output_variables[index].name, block->due_y[index]);
}

// the outputs of this sample are those to hold; no NaN travels on silently
static int take_sample(flex_block *block) {
  const flex_block_model *model = block->model;
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

int flex_block_output(flex_block *block, int index, double *value) {
  const flex_block_record *record = block->record;
  int is_known = record->is_due && (record->is_open || !block->model->feeds_through[index]);
  *value = block->y[index];
  if (record->is_moving && !is_known) return 0;
  if (evaluate(block)) return 1;
  if (!isfinite(block->due_y[index])) return refuse_output(block, index);
  *value = block->due_y[index];
  return 0;
}

// the sample that is due, for good
static int complete_sample(flex_block *block) {
  flex_block_record *record = block->record;
  if (take_sample(block)) return 1;
  memcpy(block->x, block->next_x, (size_t)block->model->n_states * sizeof *block->x);
  record->next++;
  record->is_due = record->is_taken = 0;
  return 0;
}

static double next_instant(const flex_block *block) {
  const flex_block_record *record = block->record;
  return record->start_time + block->model->offset + (double)record->next * block->model->sample_time;
}

int flex_block_tick(flex_block *block) {
  if (!block->record->is_due)
    return flex_refuse(block->message, "the clock ticks at %.9g s next, not at %.9g s", next_instant(block), block->record->time);
  block->record->is_open = 1;
  return 0;
}

int flex_block_begin(flex_block *block) {
  flex_block_record *record = block->record;
  if (take_sample(block)) return 1;
  record->is_moving = record->is_open = 1;
  record->is_due = block->model->offset <= flex_time_slack(0.0, block->model->sample_time);
  record->is_taken = record->is_due;
  return 0;
}

/* an input with derivatives says itself what it is at the end of a step */
static int follows_polynomials(const flex_inputs *inputs) {
  for (int i = 0; i < inputs->count; i++)
    if (inputs->degree[i] > 0) return 1;
  return 0;
}

int flex_block_advance(flex_block *block, double t0, double t1) {
  flex_block_record *record = block->record;
  double slack = flex_time_slack(t1, fmin(t1 - t0, block->model->sample_time));

  double samples = (t1 - t0) / block->model->sample_time;
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

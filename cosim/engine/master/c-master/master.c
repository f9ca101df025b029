/* The loop over communication points, see master.h: instructions on fixed buffers, in the order in which they are listed.
 * Whatever isn't an FMI call, a copy or the equations of a block is a callback into Python, so that the numbers are those of the
 * loop in Python. */
#include "master.h"

#include <string.h>

#define FMI2_WARNING 1
#define NO_ROLLBACK 1

typedef int (*values_call)(void *component, const unsigned *references, size_t count, double *values);
typedef int (*derivatives_call)(void *component, const unsigned *references, size_t count, const int *orders,
                                double *values);
typedef int (*step_call)(void *component, double time, double step, int no_rollback);
typedef void (*evaluation)(void *equations);
typedef int (*python_callback)(size_t point, double begin, double end);

/* 0 * x is 0 for a finite x and NaN otherwise, so that the sum is 0 if all are finite; four independent sums, no branches */
static int all_finite(const double *values, size_t count) {
  double sums[] = {0.0, 0.0, 0.0, 0.0};
  const size_t lanes = sizeof sums / sizeof *sums;
  size_t i = 0;
  for (; i + lanes <= count; i += lanes)
    for (size_t lane = 0; lane < lanes; lane++) sums[lane] += 0.0 * values[i + lane];
  for (; i < count; i++) sums[0] += 0.0 * values[i];
  return sums[0] + sums[1] + sums[2] + sums[3] == 0.0;
}

static void gather(const master_instruction *op, const double *source) {
  for (size_t i = 0; i < op->count; i++) op->target[op->places[i]] = source[op->columns[i]];
}

/* fmi2SetReal with values that have changed since */
static int refresh(const master_instruction *op, const double *source) {
  int same = 1;
  for (size_t i = 0; i < op->count; i++)
    same = same && memcmp(&op->target[i], &source[op->columns[i]], sizeof(double)) == 0;
  if (same) return 0;
  for (size_t i = 0; i < op->count; i++) op->target[i] = source[op->columns[i]];
  return ((values_call)op->function)(*op->component, op->references, op->count, op->target);
}

/* from the last sample instant to this one, unless it is reached already */
static int step_to(const master_instruction *op, double time) {
  double *reached = &op->target[0];
  const double step = op->target[1] > 0.0 ? op->target[1] : time - *reached;
  if (!(time > *reached)) return 0;
  const int status = ((step_call)op->function)(*op->component, *reached, step, NO_ROLLBACK);
  if (status <= FMI2_WARNING) *reached = time;
  return status;
}

/* from this sample instant to the next one */
static int step_task(const master_instruction *op) {
  const double first = op->target[0], sample_time = op->target[1];
  double *count = &op->target[2];
  const int status = ((step_call)op->function)(*op->component, first + *count * sample_time, sample_time, NO_ROLLBACK);
  if (status <= FMI2_WARNING) *count += 1.0;
  return status;
}

/* one instruction; returns 0, or 1 with the status of the failure */
static int carry_out(const master_instruction *op, size_t point, double begin, double end, int *status) {
  *status = 0;
  switch (op->kind) {
    case MASTER_VALUES:
      *status = ((values_call)op->function)(*op->component, op->references, op->count, op->target);
      return *status > FMI2_WARNING;
    case MASTER_DERIVATIVES:
      *status = ((derivatives_call)op->function)(*op->component, op->references, op->count, op->orders, op->target);
      return *status > FMI2_WARNING;
    case MASTER_STEP:
      *status = ((step_call)op->function)(*op->component, begin, end - begin, NO_ROLLBACK);
      return *status > FMI2_WARNING;
    case MASTER_COPY:
      memcpy(op->target, op->source + point * op->stride, op->count * sizeof(double));
      return 0;
    case MASTER_GATHER:
      gather(op, op->source + point * op->stride);
      return 0;
    case MASTER_FINITE:
      return !all_finite(op->target, op->count);
    case MASTER_EVALUATE:
      if (op->count == 0 || memcmp(op->target, op->source, op->count * sizeof(double)) != 0)
        ((evaluation)op->function)(*op->component);
      return 0;
    case MASTER_SAMPLE:
      *status = step_to(op, end);
      return *status > FMI2_WARNING;
    case MASTER_REFRESH:
      *status = refresh(op, op->source);
      return *status > FMI2_WARNING;
    case MASTER_TASK:
      *status = step_task(op);
      return *status > FMI2_WARNING;
    case MASTER_MULTIPLY:
      for (size_t i = 0; i < op->count; i++) op->target[op->places[i]] *= op->source[i];
      return 0;
    case MASTER_ADD:
      for (size_t i = 0; i < op->count; i++) op->target[op->places[i]] += op->source[i];
      return 0;
    default:
      return ((python_callback)op->function)(point, begin, end);
  }
}

/* whether an instruction is carried out at this point */
static int applies(const master_instruction *op, size_t point, int jump) {
  if (op->condition == MASTER_AT_JUMPS) return jump;
  return op->condition == MASTER_ALWAYS || op->due[point];
}

/* the instructions of a list, in order; returns 0, or 1 with the index of the failed one added to progress->instruction */
static int carry_out_all(const master_instruction *list, size_t count, size_t point, double begin, double end, int jump,
                         volatile int *active, master_progress *progress) {
  for (size_t i = 0; i < count; i++) {
    if (!applies(&list[i], point, jump)) continue;
    *active = list[i].owner;
    if (carry_out(&list[i], point, begin, end, &progress->status)) {
      progress->instruction += i;
      return 1;
    }
  }
  return 0;
}

/* copy all recorded signals to the ends of their columns */
static void record(const master_program *program, double time, master_progress *progress) {
  for (size_t i = 0; i < program->n_channels; i++) {
    const master_channel *channel = &program->channels[i];
    double *end = channel->columns + progress->records;
    for (size_t n = 0; n < channel->count; n++) end[n * program->capacity] = channel->signals[n];
  }
  program->recorded_times[progress->records++] = time;
}

EXPORTED int master_run(const master_program *program, size_t points, master_progress *progress) {
  while (progress->points < points) {
    const size_t point = progress->points + 1;
    const double begin = program->times[point - 1], end = program->times[point];
    const int jump = program->jumps[point], recorded = program->instants[point];
    /* all slaves step to the point */
    progress->instruction = 0;
    if (carry_out_all(program->advance, program->n_advance, point, begin, end, jump, program->active, progress)) return 1;
    progress->points = point;
    /* left limits where signals may jump, then the exchange, then right limits */
    if (jump && recorded) record(program, end, progress);
    progress->instruction = program->n_advance;
    if (carry_out_all(program->exchange, program->n_exchange, point, end, end, jump, program->active, progress)) return 1;
    if (recorded) record(program, end, progress);
  }
  return 0;
}

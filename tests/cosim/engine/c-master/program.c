/* A program of all instructions but callbacks into Python, on an FMU that counts: what each must have written is known. */
#include <stdio.h>
#include <string.h>

#include "master.h"

#define POINTS 10
#define CHECK(condition) \
  if (!(condition)) return printf("line %d: %s\n", __LINE__, #condition), 1

enum { N = 3, FAILS = 7 };

typedef struct {
  double inputs[N], time;
  int steps, sets;
} counter;

static int set_values(void *component, const unsigned *references, size_t count, const double *values) {
  counter *fmu = component;
  for (size_t i = 0; i < count; i++) fmu->inputs[references[i]] = values[i];
  fmu->sets++;
  return 0;
}

static int get_derivatives(void *component, const unsigned *references, size_t count, const int *orders, double *values) {
  const counter *fmu = component;
  for (size_t i = 0; i < count; i++) values[i] = orders[i] * fmu->inputs[references[i]];
  return 0;
}

static int step(void *component, double time, double length, int no_rollback) {
  counter *fmu = component;
  if (!no_rollback || fmu->steps == FAILS) return 3;
  fmu->time = time + length, fmu->steps++;
  return 0;
}

static void square(void *memory) {
  double *values = memory;
  values[1] = values[0] * values[0];
  values[2] += 1.0;
}

/* the places of functions with other types in an instruction */
typedef void (*function)(void);

int main(int argc, char **argv) {
  (void)argv;
  static double times[POINTS + 1], recorded_times[2 * POINTS], columns[N][2 * POINTS], table[POINTS + 1][4];
  static unsigned char jumps[POINTS + 1], instants[POINTS + 1], due[POINTS + 1];
  static counter plant, sampled, task;
  static double row[N], memory[3], seen[1], sent[2], sampled_at[2] = {0.0, 0.0}, task_at[3] = {0.0, 0.5, 0.0};
  void *const handles[] = {&plant, &sampled, &task, memory};
  const unsigned references[] = {0, 1, 2};
  const int orders[] = {1, 2, 3};
  const double halves[] = {0.5};
  const long long backwards[] = {2, 1, 0}, first[] = {0, 1, 2}, pair[] = {2, 0};
  for (int k = 0; k <= POINTS; k++) {
    times[k] = 0.25 * k, jumps[k] = k % 4 == 0, instants[k] = 1, due[k] = k % 2 == 0;
    for (int i = 0; i < 4; i++) table[k][i] = 10.0 * k + i;
  }
  /* over a step: the plant steps; at an instant: a row of the table backwards into the plant, a block of its first number, and
   * FMUs that are due */
  const master_instruction advance[] = {
      {.kind = MASTER_STEP, .function = (function)step, .component = &handles[0]},
  };
  const master_instruction exchange[] = {
      {.kind = MASTER_GATHER, .source = table[0], .stride = 4, .count = N, .columns = backwards, .places = first, .target = row},
      {.kind = MASTER_VALUES, .function = (function)set_values, .component = &handles[0], .references = references,
       .count = N, .target = row},
      {.kind = MASTER_COPY, .source = row, .count = 1, .target = memory},
      {.kind = MASTER_MULTIPLY, .source = halves, .count = 1, .places = first, .target = memory},
      {.kind = MASTER_ADD, .source = halves, .count = 1, .places = first, .target = memory},
      {.kind = MASTER_EVALUATE, .condition = MASTER_WHEN_DUE, .due = due, .function = (function)square, .component = &handles[3]},
      {.kind = MASTER_EVALUATE, .function = (function)square, .component = &handles[3], .count = 1, .source = row,
       .target = seen},
      {.kind = MASTER_COPY, .source = row, .count = 1, .target = seen},
      {.kind = MASTER_EVALUATE, .function = (function)square, .component = &handles[3], .count = 1, .source = row,
       .target = seen},
      {.kind = MASTER_SAMPLE, .condition = MASTER_WHEN_DUE, .due = due, .function = (function)step, .component = &handles[1],
       .target = sampled_at},
      {.kind = MASTER_REFRESH, .function = (function)set_values, .component = &handles[1], .references = references,
       .count = 2, .source = row, .columns = pair, .target = sent},
      {.kind = MASTER_REFRESH, .function = (function)set_values, .component = &handles[1], .references = references,
       .count = 2, .source = row, .columns = pair, .target = sent},
      {.kind = MASTER_TASK, .condition = MASTER_WHEN_DUE, .due = due, .function = (function)step, .component = &handles[2],
       .target = task_at},
      {.kind = MASTER_DERIVATIVES, .condition = MASTER_AT_JUMPS, .function = (function)get_derivatives,
       .component = &handles[0], .references = references, .orders = orders, .count = N, .target = row},
      {.kind = MASTER_FINITE, .count = N, .target = row},
  };
  const master_channel channel = {row, columns[0], N};
  volatile int active = 0;
  const master_program program = {.advance = advance, .exchange = exchange, .n_advance = 1,
                                  .n_exchange = sizeof exchange / sizeof *exchange, .channels = &channel, .n_channels = 1,
                                  .capacity = 2 * POINTS, .times = times, 
                                  .jumps = jumps, .instants = instants, .recorded_times = recorded_times,
                                  .active = &active};
  master_progress progress = {0};
  /* six points: the second and the fourth jump of the grid are beyond them */
  CHECK(master_run(&program, 6, &progress) == 0);
  CHECK(progress.points == 6 && progress.records == 7);
  CHECK(plant.steps == 6 && plant.time == 1.5 && plant.inputs[0] == 62.0 && plant.inputs[2] == 60.0);
  CHECK(memory[1] == 31.5 * 31.5 && memory[2] == 3 + 6);
  CHECK(sampled.steps == 3 && sampled.time == 1.5 && sampled.sets == 6 && sampled.inputs[0] == 60.0 && sampled.inputs[1] == 62.0);
  CHECK(task.steps == 3 && task.time == 1.5);
  /* left limits of the jump at 1 s, then its derivatives */
  CHECK(recorded_times[3] == 1.0 && recorded_times[4] == 1.0);
  CHECK(columns[0][3] == 32.0 && columns[0][4] == 42.0 && columns[2][4] == 3.0 * 40.0);
  /* with an argument the plant fails in its eighth step, else it isn't finite */
  if (argc == 1) table[7][0] = 0.0 / (double)(progress.status);
  CHECK(master_run(&program, POINTS, &progress) == 1);
  if (argc == 1) {
    CHECK(progress.points == 7 && progress.instruction == 15 && progress.status == 0);
  } else {
    CHECK(progress.points == 7 && progress.instruction == 0 && progress.status == 3);
  }
  return 0;
}

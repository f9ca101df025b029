/* Variants in lockstep. Where a communication step fails, each variant tries it by itself, in all lanes at once: those that
 * fail leave, their lanes go on as copies of one that doesn't, and so no variant depends on whether its neighbours fail. */
#include "batch.h"

#include "batch_peaks.h"
#include "integration_step.h"
#include "plant.h"

/* evaluations of the equations that lanes may make after some of them were changed, see integrator.c */
#ifndef FLEX_WORK_AT_START
#define FLEX_WORK_AT_START 1e6
#endif

typedef struct {
  const flex_batch_task *task;
  flex_plant *plant;
  real *kept;      /* the lanes before variants try a step by themselves */
  real *recording; /* [instants (order + 1) n_recorded] */
  real *motion;    /* position, rate and acceleration [instants 3 n], if derivatives are calculated later */
  int *has_rates;  /* [instants] 1 = the recording has the derivatives */
  real pace;       /* of the motions */
  int *gone;       /* [FLEX_WIDTH] 1 = the lane is a copy of another one */
} flex_batch;

// number of recorded instants
static int flex_batch_instants(const flex_batch_task *task) {
  int count = task->n_points;
  for (int i = 0; i < task->n_points; i++) count += task->jumps[i];
  return count;
}

/* arrays of a plant that a lane's future depends on; without the Newton matrix and the last steps, which are made anew */
enum { PIECES = 11 };
typedef struct {
  real *at;
  int count;
} piece;

static void find_pieces(flex_batch *whole, piece *pieces) {
  flex_plant *plant = whole->plant;
  const flex_model *model = plant->model;
  flex_integrator *g = &plant->integrator;
  const piece found[PIECES] = {
      {plant->p, model->n_parameters},
      {plant->d, model->n_derived},
      {plant->scale, 2 * model->n + 1},
      {plant->u, model->n_inputs},
      {plant->previous_u, model->n_inputs},
      {g->y, 5 * model->n}, /* position, rate, their roundings, acceleration */
      {plant->outputs, model->n_outputs},
      {plant->inputs.coefficients, model->n_inputs * (model->max_input_order + 1)},
      {&g->record->scale, 1},
      {&g->stages.pace, 1},
      {&whole->pace, 1},
  };
  memcpy(pieces, found, sizeof found);
}

static size_t lane_numbers(const flex_model *model) {
  return (size_t)(model->n_parameters + model->n_derived + 7 * model->n + 4 + model->n_outputs) +
         (size_t)model->n_inputs * (size_t)(model->max_input_order + 3);
}

// bytes before the plant, whose alignment is that of all pieces
static size_t take_whole(flex_batch *whole, const flex_batch_task *task, flex_arena *arena) {
  whole->kept = flex_take_reals(arena, lane_numbers(&flex_the_model));
  whole->recording = flex_take_reals(arena, (size_t)flex_batch_instants(task) * (size_t)(task->order + 1) * (size_t)task->n_recorded);
  whole->motion = flex_take_reals(arena, task->finds_peaks ? (size_t)(flex_batch_instants(task) * 3 * flex_the_model.n) : 0);
  whole->has_rates = flex_take_ints(arena, (size_t)flex_batch_instants(task));
  whole->gone = flex_take_ints(arena, FLEX_WIDTH);
  return arena->used;
}

size_t flex_batch_size(const flex_batch_task *task) {
  flex_batch whole;
  flex_arena arena = {NULL, 0};
  return take_whole(&whole, task, &arena) + flex_plant_size(&flex_the_model) + sizeof(real);
}

// pieces of the caller's memory, from its first aligned byte on
static flex_batch flex_batch_create(const flex_batch_task *task, void *memory) {
  flex_batch whole = {task, NULL, NULL, NULL, NULL, NULL, flex_real(1.0), NULL};
  char *first = memory;
  flex_arena arena = {first + (sizeof(real) - (uintptr_t)first % sizeof(real)) % sizeof(real), 0};
  size_t used = take_whole(&whole, task, &arena);
  whole.plant = flex_plant_create(&flex_the_model, arena.block + used);
  return whole;
}

static void keep_lanes(flex_batch *whole) {
  piece pieces[PIECES];
  real *to = whole->kept;
  find_pieces(whole, pieces);
  for (int i = 0; i < PIECES; to += pieces[i++].count) memcpy(to, pieces[i].at, (size_t)pieces[i].count * sizeof(real));
}

// the kept lanes, but each as a copy of the lane that `from` names
static void put_lanes(flex_batch *whole, const int *from) {
  piece pieces[PIECES];
  const real *kept = whole->kept;
  find_pieces(whole, pieces);
  for (int i = 0; i < PIECES; i++)
    for (int c = 0; c < pieces[i].count; c++, kept++)
      for (int lane = 0; lane < FLEX_WIDTH; lane++) flex_set_lane(pieces[i].at + c, lane, flex_lane(*kept, from[lane]));
}

static void set_lane_parameters(flex_batch *whole, int lane, const double *values) {
  const flex_batch_task *task = whole->task;
  for (int i = 0; i < flex_the_model.n_parameters; i++) flex_set_lane(whole->plant->p + i, lane, task->parameters[i]);
  for (int i = 0; i < task->n_changed; i++) flex_set_lane(whole->plant->p + task->changed[i], lane, values[1 + i]);
  flex_set_lane(&whole->pace, lane, values[0]);
}

// inputs before the motion
static void set_before(flex_batch *whole) {
  flex_inputs *inputs = &whole->plant->inputs;
  for (int i = 0; i < inputs->count; i++) flex_inputs_set(inputs, i, whole->task->times[0], flex_real(whole->task->before[i]));
  flex_plant_inputs_changed(whole->plant);
}

// pace of the lanes in the step that begins at a communication point
static real flex_batch_pace(const flex_batch *whole, int point) { return point < whole->task->n_motion ? whole->pace : flex_real(1.0); }

// polynomials of that step in the common time; a lane with another pace has other rates
static void set_inputs(flex_batch *whole, int point) {
  const flex_batch_task *task = whole->task;
  flex_inputs *inputs = &whole->plant->inputs;
  int m = inputs->count, orders = task->n_orders;
  const double *derivatives = task->polynomials + (size_t)point * (size_t)(orders * m);
  real pace = flex_batch_pace(whole, point);
  whole->plant->integrator.stages.pace = pace;
  const real slower[] = {flex_real(1.0), 1.0 / pace, 1.0 / (pace * pace)};
  if (point == task->n_motion && !flex_is_zero_or_more(-flex_fabs(whole->pace - 1.0)))
    flex_step_restart(&whole->plant->integrator);
  for (int i = 0; i < m; i++) {
    real *coefficients = inputs->coefficients + i * (inputs->order + 1);
    for (int k = 0; k < orders; k++)
      coefficients[k] = derivatives[k * m + i] / flex_factorial(k) * slower[task->kinds[i]];
    inputs->base[i] = task->times[point];
    inputs->degree[i] = orders - 1;
  }
  flex_plant_inputs_changed(whole->plant);
}

// to a time, with outputs and their rates there; the start if the motion hasn't begun
static int reach(flex_batch *whole, double time) {
  flex_plant *plant = whole->plant;
  int order = whole->task->finds_peaks ? 0 : whole->task->order;
  if (plant->record->is_moving && plant->record->time < time &&
      flex_plant_advance(plant, plant->record->time, time).outcome != FLEX_DONE)
    return 0;
  return flex_plant_need_outputs(plant).outcome == FLEX_DONE &&
         (order == 0 || flex_plant_need_rates(plant, order).outcome == FLEX_DONE);
}

// goes on with lanes that were changed
static void resume(flex_batch *whole) {
  flex_plant *plant = whole->plant;
  if (!plant->record->is_moving) {
    flex_plant_parameters_changed(plant);
    return;
  }
  flex_step_restart(&plant->integrator);
  flex_plant_moved(plant);
  plant->record->integrator.step = 0.0;
  plant->integrator.work_left = FLEX_WORK_AT_START;
  plant->record->integrator.is_factored = 0;
}

// variants that can't reach the time by themselves leave; returns whether one can, and the others have gone on with it
static int part(flex_batch *whole, double time) {
  int from[FLEX_WIDTH], survivor = -1;
  double now = whole->plant->record->time;
  keep_lanes(whole);

  // each variant in all lanes, from where all are
  for (int lane = 0; lane < FLEX_WIDTH; lane++) {
    if (whole->gone[lane]) continue;
    for (int k = 0; k < FLEX_WIDTH; k++) from[k] = lane;
    put_lanes(whole, from);
    resume(whole);
    whole->gone[lane] = !reach(whole, time);
    if (!whole->gone[lane]) survivor = lane;
    whole->plant->record->time = now;
  }
  if (survivor < 0) return 0;

  // the survivors together
  for (int lane = 0; lane < FLEX_WIDTH; lane++) from[lane] = whole->gone[lane] ? survivor : lane;
  put_lanes(whole, from);
  resume(whole);
  return reach(whole, time);
}

static int arrive(flex_batch *whole, double time) { return reach(whole, time) || part(whole, time); }

// the recording of an instant [(order + 1) n_recorded]
static real *flex_batch_at(const flex_batch *whole, int instant) {
  return whole->recording + (size_t)instant * (size_t)((whole->task->order + 1) * whole->task->n_recorded);
}

// outputs of orders first to last at the present point
static void record_orders(flex_batch *whole, int instant, int first, int last) {
  const flex_batch_task *task = whole->task;
  const real *rates[] = {whole->plant->outputs, whole->plant->first_rates, whole->plant->second_rates};
  real *to = flex_batch_at(whole, instant) + first * task->n_recorded;
  for (int k = first; k <= last; k++)
    for (int i = 0; i < task->n_recorded; i++) *to++ = rates[k][task->recorded[i]];
}

static void record(flex_batch *whole, int instant) {
  const flex_integrator *g = &whole->plant->integrator;
  size_t n = (size_t)g->n;
  whole->has_rates[instant] = !whole->task->finds_peaks;
  record_orders(whole, instant, 0, whole->task->finds_peaks ? 0 : whole->task->order);
  if (!whole->task->finds_peaks) return;

  // the motion, for derivatives later
  real *to = whole->motion + 3 * n * (size_t)instant;
  memcpy(to, g->y, n * sizeof(real));
  memcpy(to + n, g->v, n * sizeof(real));
  memcpy(to + 2 * n, g->a, n * sizeof(real));
}

// derivatives at an instant of a motion that is over, with the inputs of the step that begins at a communication point
static void flex_batch_add_rates(flex_batch *whole, int instant, int step, double time) {
  flex_plant *plant = whole->plant;
  flex_integrator *g = &plant->integrator;
  size_t n = (size_t)g->n;
  const real *from = whole->motion + 3 * n * (size_t)instant;
  if (whole->has_rates[instant]) return;
  memcpy(g->y, from, n * sizeof(real));
  memcpy(g->v, from + n, n * sizeof(real));
  memcpy(g->a, from + 2 * n, n * sizeof(real));

  // the acceleration is there, the factor of the mass matrix isn't
  set_inputs(whole, step);
  plant->record->time = time;
  flex_inputs_evaluate(&plant->inputs, time, 0.0, plant->u);
  plant->record->have = FLEX_HAVE_DERIVED | FLEX_HAVE_START | FLEX_HAVE_ACCELERATION;
  plant->record->integrator.is_factored = 0;
  whole->has_rates[instant] = flex_plant_need_rates(plant, 2).outcome == FLEX_DONE;
  record_orders(whole, instant, 1, 2);
}

// the start: outputs at rest, then the motion begins
static int begin(flex_batch *whole, int *instant) {
  const flex_batch_task *task = whole->task;
  flex_plant *plant = whole->plant;
  set_before(whole);
  if (!arrive(whole, task->times[0])) return 0;
  if (task->jumps[0]) record(whole, (*instant)++);
  return flex_plant_begin(plant).outcome == FLEX_DONE;
}

// the whole motion; 0 if no variant reaches its end
static int simulate(flex_batch *whole) {
  const flex_batch_task *task = whole->task;
  int instant = 0;
  if (!begin(whole, &instant)) return 0;
  for (int point = 0; point < task->n_points; point++) {
    // left limits, where inputs may jump
    double time = task->times[point];
    if (point > 0) {
      if (!arrive(whole, time)) return 0;
      if (task->jumps[point]) record(whole, instant++);
    }
    // right limits
    if (point + 1 < task->n_points) set_inputs(whole, point);
    if ((point == 0 || task->jumps[point]) && !arrive(whole, time)) return 0;
    record(whole, instant++);
  }
  return 1;
}

// up to FLEX_WIDTH variants; lanes without one repeat the last
static void flex_batch_run(flex_batch *whole, int count, const double *values, int *failed) {
  const flex_batch_task *task = whole->task;
  flex_plant *plant = whole->plant;
  flex_plant_reset(plant);
  plant->record->tolerance = task->tolerance;
  plant->record->fixed_step = task->fixed_step;
  plant->record->method = task->method;
  plant->record->starts_static = task->starts_static;
  for (int lane = 0; lane < FLEX_WIDTH; lane++) {
    set_lane_parameters(whole, lane, values + (size_t)(lane < count ? lane : count - 1) * (size_t)(1 + task->n_changed));
    whole->gone[lane] = lane >= count;
  }
  flex_plant_parameters_changed(plant);
  flex_plant_set_start_time(plant, task->times[0]);
  int is_done = simulate(whole);
  for (int lane = 0; lane < count; lane++) failed[lane] = !is_done || whole->gone[lane];
}

int flex_batch_width(void) { return FLEX_WIDTH; }

void flex_batch_record(const flex_batch_task *task, void *memory, int count, const double *values, double *recordings,
                       int *failed) {
  flex_batch whole = flex_batch_create(task, memory);
  int n = task->n_recorded, orders = task->order + 1, times = flex_batch_instants(task);
  for (int first = 0; first < count; first += FLEX_WIDTH) {
    int members = count - first < FLEX_WIDTH ? count - first : FLEX_WIDTH;
    flex_batch_run(&whole, members, values + (size_t)first * (size_t)(1 + task->n_changed), failed + first);

    // by variants, outputs and orders
    size_t stride = (size_t)(orders * n);
    double *to = recordings + (size_t)first * stride * (size_t)times;
    for (int lane = 0; lane < members; lane++)
      for (int i = 0; i < n; i++)
        for (int k = 0; k < orders; k++)
          for (int j = 0; j < times; j++) *to++ = flex_lane(whole.recording[(size_t)j * stride + (size_t)(k * n + i)], lane);
  }
}

// how far a smooth signal may go beyond its values: eight times what a parabola through neighbours does
static real second_difference(const flex_batch *whole, int before, int at, int after, int output) {
  return flex_fabs(flex_batch_at(whole, before)[output] - 2.0 * flex_batch_at(whole, at)[output] +
                   flex_batch_at(whole, after)[output]);
}

// largest magnitudes of an output up to a time
static real find_peak(flex_batch *whole, double end, int output) {
  const flex_batch_task *task = whole->task;
  int stride = task->n_recorded;
  real peak = flex_real(0.0);

  // of all values, then in the segments that may go beyond
  for (int pass = 0, instant = 0; pass < 2; pass++, instant = 0)
    for (int point = 0; point + 1 < task->n_points && task->times[point + 1] <= end; point++, instant++) {
      instant += task->jumps[point];
      const real *left = flex_batch_at(whole, instant) + output, *right = flex_batch_at(whole, instant + 1) + output;
      real larger = flex_larger(flex_fabs(*left), flex_fabs(*right)), beyond = flex_real(0.0);
      if (pass == 0) {
        peak = flex_larger(peak, larger);
        continue;
      }
      int follows = point > 0 && !task->jumps[point], goes_on = point + 2 < task->n_points && !task->jumps[point + 1];
      if (follows) beyond = second_difference(whole, instant - 1, instant, instant + 1, output);
      if (goes_on) beyond = flex_larger(beyond, second_difference(whole, instant, instant + 1, instant + 2, output));
      if ((follows || goes_on) && flex_is_positive(peak - larger - beyond)) continue;
      flex_batch_add_rates(whole, instant, point, task->times[point]);
      flex_batch_add_rates(whole, instant + 1, point, task->times[point + 1]);
      real step = (task->times[point + 1] - task->times[point]) * flex_batch_pace(whole, point);
      peak = flex_segment_peak(step, stride, left, right, peak);
    }
  return peak;
}

void flex_batch_peaks(const flex_batch_task *task, void *memory, double end, int count, const double *values, double *peaks,
                      int *failed) {
  flex_batch whole = flex_batch_create(task, memory);
  for (int first = 0; first < count; first += FLEX_WIDTH) {
    int members = count - first < FLEX_WIDTH ? count - first : FLEX_WIDTH;
    flex_batch_run(&whole, members, values + (size_t)first * (size_t)(1 + task->n_changed), failed + first);
    int is_done = 0;
    for (int lane = 0; lane < members; lane++) is_done |= !failed[first + lane];
    for (int i = 0; is_done && i < task->n_recorded; i++) {
      real peak = find_peak(&whole, end, i);
      for (int lane = 0; lane < members; lane++) peaks[(first + lane) * task->n_recorded + i] = flex_lane(peak, lane);
    }
  }
}

/* What is asked of variants in lockstep: their recordings, or the peaks of their outputs. */
#include "batch_peaks.h"
#include "batch_run.h"

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

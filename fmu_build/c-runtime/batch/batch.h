/* Variants of a motion-driven plant in lockstep: a lane of every `real` for each variant, common communication points, steps
 * and Newton matrices' pivots. A library of its own, beside the FMU and of the same sources. */
#ifndef FLEXFMU_BATCH_H
#define FLEXFMU_BATCH_H

#include <stddef.h>

#include "private.h"

/* what all variants share */
typedef struct {
  /* communication points [n_points]: times [s], and whether inputs may jump there */
  int n_points;
  const double *times;
  const int *jumps;

  /* inputs: values before the first point [n_inputs], then polynomials of each step by their derivatives at its beginning
   * [(n_points - 1) n_orders n_inputs] */
  int n_orders;
  const double *before, *polynomials;

  /* motions of one shape: so many points have to be reached for the motion's end, up to which a variant's own time has its pace;
   * for each input the order of the time derivative that it is [n_inputs] */
  int n_motion;
  const int *kinds;

  /* solver: as the FMU's parameters */
  double tolerance, fixed_step;
  int method, starts_static;

  /* parameters [n_parameters], and which of them differ between variants [n_changed] */
  const double *parameters;
  int n_changed;
  const int *changed;

  /* recorded outputs [n_recorded], and the highest order of their derivatives, 0 to 2; peaks need 2 */
  int n_recorded;
  const int *recorded;
  int order;

  /* 1 = derivatives are calculated only where peaks may be */
  int finds_peaks;
} flex_batch_task;

/* lanes of this library */
FLEX_EXPORTED int flex_batch_width(void);

/* bytes of memory that simulating a task needs, zeroed by the caller */
FLEX_EXPORTED size_t flex_batch_size(const flex_batch_task *task);

/* simulates `count` variants. values [count (1 + n_changed)]: how many times as long as that of the inputs the variant's motion
 * takes, and changed parameters. recordings [count n_recorded (order + 1)
 * instants], the instants being the communication points, those with jumps twice; failed [count]: 1 where a variant couldn't
 * be simulated */
FLEX_EXPORTED void flex_batch_record(const flex_batch_task *task, void *memory, int count, const double *values,
                                         double *recordings, int *failed);

/* simulates `count` variants; peaks [count n_recorded]: largest magnitude of each output until the time `end`, for a
 * task that finds peaks */
FLEX_EXPORTED void flex_batch_peaks(const flex_batch_task *task, void *memory, double end, int count,
                                        const double *values, double *peaks, int *failed);

#endif

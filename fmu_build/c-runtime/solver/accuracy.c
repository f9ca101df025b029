/* Two estimates of the local error: a cheap one of low order at each step, and now and then the true one, by one step against
 * two halves (accuracy.h). Their ratio, the sharpness, scales the cheap one for some steps. Step sizes follow the error's power
 * law with limits on growth and shrinking (Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.4). */
#include "accuracy.h"

#include <math.h>

#include "elementary.h"
#include "powers.h"

/* decay of the cheap estimate per step where it passes through zero */
#define HOLD 0.7

/* the calibration is trusted for so many steps, and for so much growth of the cheap estimate, of the step and of the bend;
 * without a limit on the bend an error 20 times the tolerance followed each jerk of the reference */
#define MAX_AGE 40
#define MAX_ERROR_GROWTH 3.0
#define MAX_STEP_GROWTH 1.25
#define MAX_BEND_GROWTH 4.0

/* aim below what is allowed: the error of a step goes with its seventh or ninth power */
#define SAFETY 0.5

/* limits of a change of the step size, and a change that is worth new factors */
#define MAX_GROWTH 2.0
#define MIN_SHRINK 0.1
#define WORTHWHILE_SHRINK 0.9
#define WORTHWHILE_GROWTH 1.15

void flex_accuracy_clear(flex_accuracy *accuracy) {
  accuracy->held_error = 0.0;
  accuracy->held_step = 1.0;
  accuracy->sharpness = 0.0;
}

double flex_accuracy_hold(flex_accuracy *accuracy, int stages, double error, double step) {
  // the last estimate, scaled to this step and faded, is a lower limit
  double ratio = fmin(step / accuracy->held_step, 1.0);
  double held = fmax(error, HOLD * accuracy->held_error * flex_whole_power(ratio, stages + 1));
  accuracy->held_error = held;
  accuracy->held_step = step;
  return held;
}

int flex_accuracy_applies(const flex_accuracy *accuracy, const flex_evidence *evidence) {
  // recent enough, and the motion hasn't changed its character since
  return accuracy->sharpness > 0.0 && accuracy->age < MAX_AGE && evidence->step <= MAX_STEP_GROWTH * accuracy->step &&
         evidence->error <= MAX_ERROR_GROWTH * accuracy->error && evidence->bend <= MAX_BEND_GROWTH * accuracy->bend;
}

double flex_accuracy_error(const flex_accuracy *accuracy, int excess, const flex_evidence *evidence) {
  // the ratio at the calibration, which goes with the step to the power by which the true error is of higher order
  return evidence->error * accuracy->sharpness * flex_whole_power(evidence->step / accuracy->step, excess);
}

void flex_accuracy_calibrate(flex_accuracy *accuracy, const flex_evidence *evidence, double true_error) {
  accuracy->sharpness = fmin(1.0, true_error / evidence->error);
  accuracy->step = evidence->step;
  accuracy->error = evidence->error;
  accuracy->bend = evidence->bend;
  accuracy->age = 0;
}

double flex_fitting_step(double step, double suggested, double error, double allowed, int order) {
  // the longest step, where even it is accurate enough; else the error's power law
  double longest = fmax(MAX_GROWTH * step, suggested);
  if (error * flex_whole_power(longest / step, order) <= SAFETY * allowed) return longest;
  return step * flex_root(SAFETY * allowed / error, order);
}

double flex_next_step(double step, double suggested, double fitting) {
  // a single error estimate may be wrong: no more than twice as long, no less than a tenth
  double limited = fmax(fmin(fitting, MAX_GROWTH * step), MIN_SHRINK * step);

  // a step that was cut short, to end with the communication step, says little about long ones
  if (step < 0.99 * suggested) return fmax(limited, fmin(suggested, fitting));

  // small changes aren't worth new factors
  return fitting < WORTHWHILE_SHRINK * step || fitting > WORTHWHILE_GROWTH * step ? limited : step;
}

double flex_smaller_step(double step, double fitting, double most) {
  return fmax(MIN_SHRINK * step, fmin(fitting, most * step));
}

/* What is known about the local error of a collocation method of s stages, and the step sizes that follow from it.
 *
 * The cheap estimate of every step is of order s + 1 only and so far too pessimistic where the method has order 2 s. A
 * calibration, one step against two of half its size, tells how much; until the next one the cheap estimate times what was
 * found is trusted, as long as the motion stays what it was. */
#ifndef FLEXFMU_ACCURACY_H
#define FLEXFMU_ACCURACY_H

/* plain numbers, saved and restored with the state of the plant */
typedef struct {
  double held_error; /* cheap estimate, decaying where it passes through zero */
  double held_step;  /* [s], step that it belongs to */
  double sharpness;  /* true error / cheap estimate at the last calibration; 0 = not calibrated */
  double step;       /* [s] of the calibration */
  double error;      /* cheap estimate there */
  double bend;       /* what prediction missed there, in units of its reach: a high derivative of the motion */
  int age;           /* steps since then */
} flex_accuracy;

/* what one step has shown */
typedef struct {
  double step;  /* [s] */
  double error; /* cheap estimate */
  double bend;
} flex_evidence;

void flex_accuracy_clear(flex_accuracy *accuracy);

/* the cheap estimate bridged over its zeros; becomes the one that is held */
double flex_accuracy_hold(flex_accuracy *accuracy, int stages, double error, double step);

/* whether the last calibration says something about a step */
int flex_accuracy_applies(const flex_accuracy *accuracy, const flex_evidence *evidence);

/* estimate of the true error of a step to which the calibration applies; excess: of its order over the cheap estimate's */
double flex_accuracy_error(const flex_accuracy *accuracy, int excess, const flex_evidence *evidence);

/* takes note of the true error of a step */
void flex_accuracy_calibrate(flex_accuracy *accuracy, const flex_evidence *evidence, double true_error);

/* step size at which an error of the given order would be what is allowed, with a margin; at most the longest that can follow
 * a step of size `step` where `suggested` was possible before */
double flex_fitting_step(double step, double suggested, double error, double allowed, int order);

/* step size to go on with after a step of size `step`, where `suggested` was possible before and `fitting` would fit now */
double flex_next_step(double step, double suggested, double fitting);

/* step size to try again with after a step that was too inaccurate */
double flex_smaller_step(double step, double fitting, double most);

#endif

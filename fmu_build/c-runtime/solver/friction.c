/* Modes of dry friction by rate and force, and events within a step: the step's interpolant shows where an indicator changes
 * sign, then the step is made again until it ends there, by regula falsi with the Illinois modification (Dowell and Jarratt,
 * A modified regula falsi method, BIT 11 (1971)). Sources of the modes: friction.h. */
#include "friction.h"

// friction that sticks needs decisions that lanes can't take apart
#if FLEX_WIDTH == 1

#include <float.h>
#include <math.h>
#include <string.h>

#include "elementary.h"
#include "events.h"
#include "integration_step.h"

/* an event is found when its indicator is so little below zero: a part of the breakaway force or of the reference rate, the
 * rate whose energy is the floor of the error norm */
#define EVENT_TOLERANCE 1e-11

/* by so much a mode may be wrong before an importer is asked for an event: what its integrator misses must not look like one.
 * The rate may be as inaccurate as the importer likes, the force is not */
#define RATE_HYSTERESIS 1e-6
#define FORCE_HYSTERESIS 1e-9

/* a step that ends so little before an instant [s] has come to it */
#define AT_INSTANT 5e-10

/* so often a step is looked at: links may swing within it */
#define LOOKS 4

/* trials for an event, after which the interval that is left is as short as it gets */
#define MOST_TRIALS 60

// rate of a friction's unknown relative to the reference rate
static double relative_rate(const flex_integrator *integrator, int friction, const double *v) {
  int i = integrator->stages.equations->model->frictions[friction].unknown;
  return v[i] * sqrt(integrator->stages.rate_weight[i]) / *integrator->floor;
}

static double breakaway(const flex_equations *equations, int friction) {
  return equations->d[equations->model->frictions[friction].breakaway];
}

// how far a mode is from its end, relative: negative beyond it; `holding` must belong to the point
static double indicator(const flex_integrator *integrator, int friction, const double *v) {
  const flex_equations *equations = integrator->stages.equations;
  switch (equations->modes[friction]) {
    case FLEX_STUCK: return 1.0 - fabs(equations->holding[friction]) / breakaway(equations, friction);
    case FLEX_FORWARD: return relative_rate(integrator, friction, v);
    case FLEX_BACKWARD: return -relative_rate(integrator, friction, v);
  }
  return 1.0;
}

static int any_sticks(const flex_equations *equations) {
  for (int k = 0; k < equations->model->n_frictions; k++)
    if (equations->modes[k] == FLEX_STUCK) return 1;
  return 0;
}

// the least indicator at a point
static flex_outcome least_indicator(const flex_integrator *integrator, const double *y, const double *v, const double *a,
                                    const double *u, double *least) {
  flex_equations *equations = integrator->stages.equations;
  if (any_sticks(equations) && flex_residual(equations, y, v, a, u, integrator->defect)) return FLEX_NOT_FINITE;
  flex_outcome outcome = flex_events_least(integrator, y, v, a, u, least);
  if (outcome != FLEX_DONE) return outcome;
  for (int k = 0; k < equations->model->n_frictions; k++) {
    double value = indicator(integrator, k, v);
    if (!isfinite(value)) return FLEX_NOT_FINITE;
    *least = fmin(*least, value);
  }
  return FLEX_DONE;
}

// mode by the rate alone; what stands, or has passed through rest, sticks until its force says otherwise
static int mode_by_rate(const flex_integrator *integrator, int friction) {
  const flex_equations *equations = integrator->stages.equations;
  double rate = relative_rate(integrator, friction, integrator->v);
  int mode = equations->modes[friction], moving = rate > 0.0 ? FLEX_FORWARD : FLEX_BACKWARD;
  if (!(breakaway(equations, friction) > 0.0)) return FLEX_FREE;
  if (mode == FLEX_STUCK) return fabs(rate) <= RATE_HYSTERESIS ? FLEX_STUCK : moving;
  if (rate == 0.0) return FLEX_STUCK;

  // far beyond rest the importer has set this state, it hasn't passed through
  int has_passed = mode != FLEX_FREE && moving != mode && fabs(rate) <= 1.0;
  return has_passed ? FLEX_STUCK : moving;
}

static void stop(flex_integrator *integrator, int unknown, int *stopped) {
  if (integrator->v[unknown] != 0.0) *stopped = 1;
  integrator->v[unknown] = integrator->v_rest[unknown] = integrator->a[unknown] = 0.0;
}

// the friction whose force exceeds its breakaway force the most; -1 if none does
static int most_overloaded(const flex_integrator *integrator) {
  const flex_equations *equations = integrator->stages.equations;
  double least = 0.0;
  int found = -1;
  for (int k = 0; k < equations->model->n_frictions; k++) {
    double margin = equations->modes[k] == FLEX_STUCK ? indicator(integrator, k, integrator->v) : 0.0;
    if (margin < least) least = margin, found = k;
  }
  return found;
}

// what was released, but would now be accelerated against its direction since something else was released after it
static int wrongly_released(const flex_integrator *integrator, int latest) {
  const flex_equations *equations = integrator->stages.equations;
  for (int k = 0; k < equations->model->n_frictions; k++) {
    int i = equations->model->frictions[k].unknown, mode = equations->modes[k];
    if (k == latest || integrator->v[i] != 0.0) continue;
    if ((mode == FLEX_FORWARD && integrator->a[i] < 0.0) || (mode == FLEX_BACKWARD && integrator->a[i] > 0.0)) return k;
  }
  return -1;
}

// releases what cannot be held, one after the other since each relieves or loads the others
static flex_outcome release(flex_integrator *integrator, const double *u) {
  flex_equations *equations = integrator->stages.equations;
  for (int round = 0, latest = -1; round <= 4 * equations->model->n_frictions; round++) {
    flex_outcome outcome = flex_step_accelerate_present(integrator, u);
    if (outcome != FLEX_DONE) return outcome;

    // one that was released too early sticks again
    int back = latest < 0 ? -1 : wrongly_released(integrator, latest);
    if (back >= 0) {
      integrator->a[equations->model->frictions[back].unknown] = 0.0;
      flex_set_mode(equations, back, FLEX_STUCK);
      continue;
    }

    // the one that is overloaded most slips in the direction of its force
    if (!any_sticks(equations)) return FLEX_DONE;
    if (flex_residual(equations, integrator->y, integrator->v, integrator->a, u, integrator->defect)) return FLEX_NOT_FINITE;
    latest = most_overloaded(integrator);
    if (latest < 0) return FLEX_DONE;
    flex_set_mode(equations, latest, equations->holding[latest] > 0.0 ? FLEX_FORWARD : FLEX_BACKWARD);
  }
  return flex_step_accelerate_present(integrator, u);
}

flex_outcome flex_friction_settle(flex_integrator *integrator, const double *u, int *stopped) {
  flex_equations *equations = integrator->stages.equations;
  const flex_model *model = equations->model;
  size_t size = (size_t)flex_switches(model) * sizeof *equations->modes;
  memcpy(equations->earlier_modes, equations->modes, size);

  // modes by the rates, then by the forces
  for (int k = 0; k < model->n_frictions; k++) {
    int mode = mode_by_rate(integrator, k);
    flex_set_mode(equations, k, mode);
    if (mode == FLEX_STUCK) stop(integrator, model->frictions[k].unknown, stopped);
  }
  flex_outcome outcome = release(integrator, u);
  if (outcome == FLEX_DONE) outcome = flex_events_settle(integrator, u, stopped);
  if (memcmp(equations->earlier_modes, equations->modes, size) != 0) flex_step_restart(integrator);
  return outcome;
}

// a step's motion in between, into full_y, full_v, full_a: positions of degree 5 and rates of degree 3 through both ends;
// accelerations are of degree 2. Nothing but the latter is divided by the step, which may be tiny
static void interpolate(flex_integrator *integrator, double h, double x) {
  int n = integrator->n;
  const double *y0 = integrator->saved, *v0 = y0 + (integrator->v - integrator->y), *a0 = y0 + (integrator->a - integrator->y);
  for (int c = 0; c < n; c++) {
    double v = h * v0[c], a = h * h * a0[c], a1 = integrator->a[c], gain = integrator->v[c] - v0[c];
    double dv = h * gain - a, da = h * h * a1 - a, dy = integrator->y[c] - y0[c] - v - 0.5 * a;
    double p = 10.0 * dy - 4.0 * dv + 0.5 * da, q = -15.0 * dy + 7.0 * dv - da, r = 6.0 * dy - 3.0 * dv + 0.5 * da;
    double excess = gain - 0.5 * h * (a0[c] + a1);
    integrator->full_y[c] = y0[c] + x * (v + x * (0.5 * a + x * (p + x * (q + x * r))));
    integrator->full_v[c] = v0[c] + x * (h * (a0[c] + 0.5 * x * (a1 - a0[c])) + x * (3.0 - 2.0 * x) * excess);
    integrator->full_a[c] = a0[c] + x * (a1 - a0[c] + 6.0 * (1.0 - x) * excess / h);
  }
}

/* where an indicator becomes negative: times after the start of the step and values before and after */
typedef struct {
  double low, at_low, high, at_high;
} bracket;

// the least indicator at a part x of a step that was made
static flex_outcome look_at(flex_integrator *integrator, double t, double h, double x, double *value) {
  interpolate(integrator, h, x);
  flex_inputs_evaluate(integrator->stages.inputs, t, x * h, integrator->end_u);
  return least_indicator(integrator, integrator->full_y, integrator->full_v, integrator->full_a, integrator->end_u, value);
}

// looks for an event within a step that was made; high = 0 if there is none
static flex_outcome look(flex_integrator *integrator, double t, double h, bracket *event) {
  event->high = 0.0;
  for (int k = 1; k <= LOOKS; k++) {
    double x = (double)k / LOOKS, value;
    flex_outcome outcome = look_at(integrator, t, h, x, &value);
    if (outcome != FLEX_DONE) return outcome;
    if (value < 0.0) {
      event->low = x * h - h / LOOKS;
      event->high = x * h;
      event->at_high = value;
      if (k == 1) outcome = look_at(integrator, t, h, 0.0, &event->at_low);
      event->at_low = fmax(event->at_low, 0.0);
      return outcome;
    }
    event->at_low = value;
  }
  return FLEX_DONE;
}

// the next trial: regula falsi (Illinois), aimed into the tolerance below zero and away from the ends
static double next_trial(const bracket *event) {
  const double aim = 0.5 * EVENT_TOLERANCE;
  double width = event->high - event->low, share = (event->at_low + aim) / (event->at_low - event->at_high);
  return event->low + fmin(fmax(share, 0.01), 0.99) * width;
}

// narrows the bracket by a trial; the end that stays for the second time counts half
static void narrow(bracket *event, double trial, double value, int *side) {
  int is_after = value < 0.0;
  if (is_after) {
    event->high = trial;
    event->at_high = value;
    if (*side > 0) event->at_low *= 0.5;
  } else {
    event->low = trial;
    event->at_low = value;
    if (*side < 0) event->at_high *= 0.5;
  }
  *side = is_after ? 1 : -1;
}

// the present point, which a step has reached: its acceleration to the last digit, and the least indicator
static flex_outcome look_at_end(flex_integrator *integrator, double t, double h, double *value) {
  flex_inputs_evaluate(integrator->stages.inputs, t, h, integrator->end_u);
  flex_outcome outcome = flex_step_accelerate_present(integrator, integrator->end_u);
  if (outcome != FLEX_DONE) return outcome;
  return least_indicator(integrator, integrator->y, integrator->v, integrator->a, integrator->end_u, value);
}

flex_outcome flex_friction_step(flex_integrator *integrator, double t, double *h, double allowed, double *attempts,
                                double *value) {
  const flex_integrator_record before = *integrator->record;
  flex_equations *equations = integrator->stages.equations;
  bracket event;
  int side = 0, stopped = 0, is_certain = 0;

  // not beyond an instant
  if (equations->model->n_events > 0) flex_inputs_evaluate(integrator->stages.inputs, t, 0.0, integrator->end_u);
  double ahead = flex_events_next(integrator, integrator->end_u, t) - t, at_end = -1.0;
  int lands = ahead < *h + AT_INSTANT;
  if (lands) *h = fmin(*h, ahead);
  double landing = *h;

  // the step as if there were no other event, and a look at it
  flex_outcome outcome = integrator->step(integrator, t, *h, allowed, value);
  if (outcome != FLEX_DONE) return outcome;
  outcome = look(integrator, t, *h, &event);
  if (outcome != FLEX_DONE) return flex_step_reject(integrator, &before, FLEX_FAILED_SHRINK * *h, outcome);
  if (event.high == 0.0 && !lands) return FLEX_DONE;

  // the same step, ending at the event
  double least = 4.0 * DBL_EPSILON * fabs(t) + 1e-13 * *h;
  if (event.high == 0.0) outcome = look_at_end(integrator, t, *h, &at_end), at_end = -1.0;
  if (outcome != FLEX_DONE) return flex_step_reject(integrator, &before, FLEX_FAILED_SHRINK * *h, outcome);
  for (int trial = 0; event.high > 0.0; trial++) {
    // what only the interpolation has seen may be no event: the second trial asks
    int is_last = event.high - event.low <= least || trial >= MOST_TRIALS, asks = trial == 1 && !is_certain;
    double next = is_last || asks ? event.high : next_trial(&event);

    // the step again, to there
    flex_step_reject(integrator, &before, before.step, FLEX_DONE);
    *attempts += 1.0;
    outcome = integrator->step(integrator, t, next, allowed, value);
    if (outcome != FLEX_DONE) return outcome;
    *h = next;
    outcome = look_at_end(integrator, t, next, &at_end);
    if (outcome != FLEX_DONE) return flex_step_reject(integrator, &before, FLEX_FAILED_SHRINK * next, outcome);

    // near enough, or between which times to go on
    is_certain |= at_end < 0.0;
    if (is_last || (asks && !is_certain) || (at_end < 0.0 && at_end >= -EVENT_TOLERANCE)) break;
    narrow(&event, next, at_end, &side);
  }

  // modes behind the event, unless the importer asks for them; where they cannot be found, everything is as before the step
  if (at_end >= 0.0 && !(lands && *h == landing)) return FLEX_DONE;
  if (equations->model->has_clock) integrator->y[integrator->n - 1] = t + *h, integrator->y_rest[integrator->n - 1] = 0.0;
  integrator->record->at_event = integrator->stops_at_events;
  if (integrator->stops_at_events) return FLEX_DONE;
  outcome = flex_friction_settle(integrator, integrator->end_u, &stopped);
  if (outcome == FLEX_DONE) return outcome;
  memcpy(equations->modes, equations->earlier_modes, (size_t)flex_switches(equations->model) * sizeof *equations->modes);
  flex_show_modes(equations);
  return flex_step_reject(integrator, &before, FLEX_FAILED_SHRINK * *h, outcome);
}

flex_outcome flex_friction_indicators(flex_integrator *integrator, const double *u, double *indicators) {
  const flex_equations *equations = integrator->stages.equations;
  double least;
  flex_outcome outcome = least_indicator(integrator, integrator->y, integrator->v, integrator->a, u, &least);
  if (outcome != FLEX_DONE) return outcome;
  for (int k = 0; k < equations->model->n_frictions; k++)
    indicators[k] = indicator(integrator, k, integrator->v) +
                    (equations->modes[k] == FLEX_STUCK ? FORCE_HYSTERESIS : RATE_HYSTERESIS);
  return flex_events_indicators(integrator, u, indicators + equations->model->n_frictions);
}

#endif

#include "events.h"

// events need decisions that lanes can't take apart
#if FLEX_WIDTH == 1

#include <math.h>
#include <string.h>

#include "elementary.h"
#include "integration_step.h"

/* a number that is so near zero and moves towards it has passed: importers may stop before it. One that has turned back, and passes
 * again without having come to its side, may do so until it is so far beyond zero */
#define TOUCH 1e-9

/* what is forgiven beyond what was reached: twice the tolerance of the search (friction.c) */
#define MARGIN 2e-11

/* passages that follow from one another at one instant */
#define MOST_ROUNDS 20

static int event_mode(const flex_equations *equations, int event) {
  return equations->modes[equations->model->n_frictions + event];
}

// 1 or -1, or 0 before the motion begins
static double event_side(const flex_equations *equations, int event) {
  return (event_mode(equations, event) == FLEX_FORWARD) - (event_mode(equations, event) == FLEX_BACKWARD);
}

static void set_event_side(flex_equations *equations, int event, double side) {
  flex_set_mode(equations, equations->model->n_frictions + event, side > 0.0 ? FLEX_FORWARD : FLEX_BACKWARD);
}

// positive on the event's side
static double event_number(const flex_equations *equations, int event) {
  double side = event_side(equations, event);
  return side == 0.0 ? 1.0 : side * equations->crossings[event] + equations->forgiven[event];
}

// numbers and their rates along the motion
static flex_outcome evaluate_events(const flex_integrator *integrator, const double *y, const double *v, const double *a,
                             const double *u) {
  flex_equations *equations = integrator->stages.equations;
  const flex_model *model = equations->model;
  const double *const arguments[] = {y, v, a, u, equations->d};
  if (flex_call(equations, &model->event_numbers, 5, arguments, equations->crossings)) return FLEX_NOT_FINITE;
  if (!flex_all_finite(equations->crossings, model->n_events)) return FLEX_NOT_FINITE;

  // what is on its side again needs no forgiveness
  for (int k = 0; k < model->n_events; k++)
    if (event_side(equations, k) * equations->crossings[k] > 0.0) equations->forgiven[k] = 0.0;
  return FLEX_DONE;
}

flex_outcome flex_events_least(const flex_integrator *integrator, const double *y, const double *v, const double *a,
                               const double *u, double *least) {
  flex_equations *equations = integrator->stages.equations;
  *least = HUGE_VAL;
  if (equations->model->n_events == 0) return FLEX_DONE;
  flex_outcome outcome = evaluate_events(integrator, y, v, a, u);
  for (int k = 0; outcome == FLEX_DONE && k < equations->model->n_events; k++)
    if (!equations->model->events[k].is_instant) *least = fmin(*least, event_number(equations, k));
  return outcome;
}

double flex_events_next(const flex_integrator *integrator, const double *u, double time) {
  const flex_equations *equations = integrator->stages.equations;
  const flex_model *model = equations->model;
  double next = HUGE_VAL;
  int count = 0;
  for (int k = 0; k < model->n_events; k++) count += model->events[k].is_instant;
  if (count == 0 || evaluate_events(integrator, integrator->y, integrator->v, integrator->a, u) != FLEX_DONE) return next;
  for (int k = 0; k < model->n_events; k++) {
    double rate = equations->crossings[model->n_events + k];
    if (model->events[k].is_instant && event_side(equations, k) * rate < 0.0)
      next = fmin(next, time - equations->crossings[k] / rate);
  }
  return next;
}

// which numbers have passed, and whether a reset belongs to them; those without change sides
static flex_outcome find_passages(const flex_integrator *integrator, int round, double *fired, int *passages, int *resets) {
  flex_equations *equations = integrator->stages.equations;
  const flex_model *model = equations->model;
  *passages = *resets = 0;
  for (int k = 0; k < model->n_events; k++) {
    double side = event_side(equations, k), g = equations->crossings[k], rate = equations->crossings[model->n_events + k];
    fired[k] = 0.0;
    if (side == 0.0) {
      int is_past = model->events[k].at_start && g >= 0.0;
      set_event_side(equations, k, !is_past && (g > 0.0 || (g == 0.0 && rate >= 0.0)) ? 1.0 : -1.0);
      *passages = 1;
      continue;
    }
    double value = event_number(equations, k);
    if (value >= 0.0 && !(value < TOUCH && side * rate < 0.0)) continue;
    int has_reset = model->events[k].has_reset && model->events[k].direction * side <= 0.0;
    // the search ends nearer to zero; what comes farther has jumped, unless an importer stops late
    int jumped = value < -TOUCH && (round > 0 || side * rate > 0.0 || !integrator->record->modes_are_held);
    if (has_reset && side * rate > 0.0 && !jumped) {
      // it comes back by itself
      equations->forgiven[k] = fmax(0.0, MARGIN - side * g);
      continue;
    }
    if (has_reset && !jumped && equations->forgiven[k] > 0.0 && -side * g > TOUCH) return FLEX_EVENTS_ACCUMULATE;
    *passages = 1;
    if (has_reset) {
      fired[k] = 1.0;
      equations->forgiven[k] = jumped ? 0.0 : fmax(0.0, MARGIN - side * g);
      *resets = 1;
      continue;
    }
    set_event_side(equations, k, -side);
    equations->forgiven[k] = fmax(0.0, MARGIN + side * g);
  }
  return FLEX_DONE;
}

// new states, behind which a number that turns back at zero stays on its side
static flex_outcome reset_states(flex_integrator *integrator, const double *u, const double *fired) {
  flex_equations *equations = integrator->stages.equations;
  const flex_model *model = equations->model;
  size_t size = 2 * (size_t)integrator->n * sizeof(double);
  const double *const arguments[] = {integrator->y, integrator->v, u, equations->d, fired};
  if (flex_call(equations, &model->event_resets, 5, arguments, integrator->change)) return FLEX_NOT_FINITE;
  if (!flex_all_finite(integrator->change, 2 * integrator->n)) return FLEX_NOT_FINITE;
  memcpy(integrator->y, integrator->change, size);
  memset(integrator->y_rest, 0, size);
  flex_outcome outcome = flex_step_accelerate_present(integrator, u);
  if (outcome == FLEX_DONE) outcome = evaluate_events(integrator, integrator->y, integrator->v, integrator->a, u);
  for (int k = 0; outcome == FLEX_DONE && k < model->n_events; k++) {
    double side = event_side(equations, k), g = side * equations->crossings[k];
    if (fired[k] == 0.0) continue;
    int turns_back = side * equations->crossings[model->n_events + k] > 0.0 && event_number(equations, k) >= -TOUCH;
    if (!turns_back && g < TOUCH) set_event_side(equations, k, -side);
    equations->forgiven[k] = fmax(0.0, MARGIN + (turns_back ? -g : g));
  }
  return outcome;
}

flex_outcome flex_events_settle(flex_integrator *integrator, const double *u, int *changed) {
  flex_equations *equations = integrator->stages.equations;
  double *fired = equations->fired;
  int passages, resets;
  if (equations->model->n_events == 0) return FLEX_DONE;
  for (int round = 0; round < MOST_ROUNDS; round++) {
    flex_outcome outcome = evaluate_events(integrator, integrator->y, integrator->v, integrator->a, u);
    if (outcome != FLEX_DONE) return outcome;
    outcome = find_passages(integrator, round, fired, &passages, &resets);
    if (outcome != FLEX_DONE || !passages) return outcome;
    flex_step_restart(integrator);
    outcome = resets ? reset_states(integrator, u, fired) : flex_step_accelerate_present(integrator, u);
    *changed |= resets;
    if (outcome != FLEX_DONE) return outcome;
  }
  return FLEX_DONE;
}

flex_outcome flex_events_indicators(const flex_integrator *integrator, const double *u, double *indicators) {
  const flex_equations *equations = integrator->stages.equations;
  if (equations->model->n_events == 0) return FLEX_DONE;
  flex_outcome outcome = evaluate_events(integrator, integrator->y, integrator->v, integrator->a, u);
  for (int k = 0; k < equations->model->n_events; k++) indicators[k] = event_number(equations, k) + TOUCH;
  return outcome;
}

#endif

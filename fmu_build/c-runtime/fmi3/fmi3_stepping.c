/* Communication steps and events. */
#include <math.h>
#include <string.h>

#include "instance.h"

/* parts of a step, each with an intermediate update at its end, for importers that read in between */
#define PARTS 4

// one intermediate update; 1 if the importer wants the step to end there
static int update(flex_instance *ours, double time, flex_phase phase, int may_end) {
  const int asks = phase == INPUT_UPDATE, before = ours->session.phase;
  fmi3Boolean ends = fmi3False;
  double when = time;
  ours->session.phase = (int)phase;
  ours->callbacks.update(ours->callbacks.environment, time, asks, !asks, !asks, may_end, &ends, &when);
  ours->session.phase = before;
  return ends && may_end;
}

/* Asks for the inputs within a step and makes each the polynomial through these values and the present one, by forward differences:
 * w d/dt = log(1 + D), w being the distance of the instants. Inputs that aren't set at all of them stay as they are. The instants lie
 * inside of the step, whose end may be a jump's. */
static int ask_inputs(flex_instance *ours, double t, double step) {
  static const double weights[FLEX_ASKED][FLEX_ASKED] = {
      {1.0, -1.0 / 2.0, 1.0 / 3.0, -1.0 / 4.0}, {0.0, 1.0, -1.0, 11.0 / 12.0}, {0.0, 0.0, 1.0, -3.0 / 2.0}, {0.0, 0.0, 0.0, 1.0}};
  flex_backend *backend = ours->backend;
  const unsigned n = backend->n_inputs;
  const double width = step / (FLEX_ASKED + 1);
  for (unsigned i = 0; i < FLEX_ASKED * n; i++) ours->scratch[i] = NAN;
  for (unsigned k = 0; k < FLEX_ASKED; k++) {
    ours->asked = ours->scratch + k * n;
    update(ours, t + (k + 1) * width, INPUT_UPDATE, 0);
  }
  for (unsigned i = 0; i < n; i++) {
    double row[FLEX_ASKED + 1], scale = 1.0;
    if (flex_backend_get_reals(backend, &i, 1, row)) return 1;
    for (unsigned k = 0; k < FLEX_ASKED; k++) row[k + 1] = ours->scratch[k * n + i];
    for (int k = 1; k <= FLEX_ASKED; k++)
      for (int m = FLEX_ASKED; m >= k; m--) row[m] -= row[m - 1];
    for (int order = 1; order <= FLEX_ASKED && !isnan(row[FLEX_ASKED]); order++) {
      double value = 0.0;
      scale /= width;
      for (int k = order; k <= FLEX_ASKED; k++) value += weights[order - 1][k - 1] * row[k] * scale;
      if (value == 0.0 && flex_backend_input_derivative(backend, i, order) == 0.0) continue;
      if (flex_backend_set_input_derivatives(backend, &i, 1, &order, &value)) return 1;
    }
  }
  return 0;
}

/* Events within a step are handled within it, unless the importer lets steps return early. A step that fails is discarded: as the
 * standard demands, everything is as it was before. */
fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
  (void)noSetFMUStatePriorToCurrentPoint;
  const flex_call_id call = call_fmi3DoStep;
  flex_instance *ours = flex_checked(instance, call);
  if (!ours || flex_lacks(ours, call, "a place for eventHandlingNeeded", eventHandlingNeeded, 1) ||
      flex_lacks(ours, call, "a place for terminateSimulation", terminateSimulation, 1) ||
      flex_lacks(ours, call, "a place for earlyReturn", earlyReturn, 1) ||
      flex_lacks(ours, call, "a place for lastSuccessfulTime", lastSuccessfulTime, 1) ||
      flex_step_is_impossible(ours, currentCommunicationPoint, communicationStepSize))
    return fmi3Error;

  flex_backend *backend = ours->backend;
  const flex_session *session = &ours->session;
  const flex_callbacks *importer = &ours->callbacks;
  const int parts = importer->update && importer->reads ? PARTS : 1;
  double from = currentCommunicationPoint, end = from + communicationStepSize;
  int event = 0, is_refused = 0, ends = 0;
  memcpy(ours->before, backend->state, backend->state_size);
  for (int part = 1; part <= parts && !event && !is_refused && !ends; part++) {
    double to = part == parts ? end : currentCommunicationPoint + part * (communicationStepSize / parts);
    is_refused = importer->update && importer->sets_inputs && ask_inputs(ours, from, to - from);
    if (!is_refused) is_refused = flex_backend_advance(backend, from, to, session->has_events && session->returns_early ? &event : NULL);
    from = *backend->time;
    if (importer->update && !is_refused) ends = update(ours, from, OUTPUT_UPDATE, session->returns_early && from < end);
  }
  fmi3Status status = fmi3OK;
  if (is_refused) {
    status = flex_log(ours, fmi3Discard, LOG_DISCARD, "%s", backend->message);
    memcpy(backend->state, ours->before, backend->state_size);
    flex_backend_restored(backend);
  }
  *terminateSimulation = fmi3False;
  *eventHandlingNeeded = event && !is_refused;
  *earlyReturn = (event || ends) && !is_refused && *backend->time < end;
  *lastSuccessfulTime = *backend->time;
  return status;
}

// a tick of the one clock; what is sampled is completed when time goes on
fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[]) {
  const flex_call_id call = call_fmi3SetClock;
  flex_instance *ours = flex_checked(instance, call);
  if (!ours || flex_lacks(ours, call, "value references", valueReferences, nValueReferences) ||
      flex_lacks(ours, call, "values", values, nValueReferences))
    return fmi3Error;
  for (size_t i = 0; i < nValueReferences; i++) {
    if (!ours->backend->tick || valueReferences[i] != FLEX_CLOCK << 28)
      return flex_log(ours, fmi3Error, LOG_ERROR, "value reference %u is no clock", valueReferences[i]);
    if (values[i] && ours->backend->tick(ours->backend)) return flex_log_refusal(ours);
  }
  return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime) {
  flex_instance *ours = flex_checked(instance, call_fmi3UpdateDiscreteStates);
  if (!ours) return fmi3Error;
  fmi3Boolean *const flags[] = {discreteStatesNeedUpdate, terminateSimulation, nominalsOfContinuousStatesChanged,
                                valuesOfContinuousStatesChanged, nextEventTimeDefined};
  int lacks = flex_lacks(ours, call_fmi3UpdateDiscreteStates, "a place for nextEventTime", nextEventTime, 1);
  for (size_t i = 0; i < sizeof flags / sizeof *flags && !lacks; i++)
    lacks = flex_lacks(ours, call_fmi3UpdateDiscreteStates, "a place for what happened", flags[i], 1);
  if (lacks) return fmi3Error;

  int states_changed = 0, is_exchange = ours->session.kind == EXCHANGE;
  double next = HUGE_VAL;
  if (flex_backend_handle_event(ours->backend, is_exchange, &states_changed, &next)) return flex_log_refusal(ours);
  for (size_t i = 0; i < sizeof flags / sizeof *flags; i++) *flags[i] = fmi3False;
  *valuesOfContinuousStatesChanged = states_changed != 0;
  *nextEventTimeDefined = next < HUGE_VAL;
  if (*nextEventTimeDefined) *nextEventTime = next;
  return fmi3OK;
}

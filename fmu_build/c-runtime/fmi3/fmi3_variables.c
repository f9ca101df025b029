/* Values of variables, and adjoint derivatives. */
#include <limits.h>
#include <string.h>

#include "instance.h"

static size_t size_of(const flex_instance *ours, fmi3ValueReference reference) {
  unsigned sort = FLEX_SORT_OF(reference);
  if (sort == FLEX_INPUT_DERIVATIVES) return (size_t)ours->backend->max_input_order;
  return sort == FLEX_STATES ? flex_backend_states() : 1;
}

// 1 after logging it, if value references or values are missing, or their numbers don't fit
static int lacks_values(const flex_instance *ours, flex_call_id call, const fmi3ValueReference *vr, size_t nvr,
                        const void *values, size_t n_values) {
  if (flex_lacks(ours, call, "value references", vr, nvr)) return 1;
  size_t needed = 0;
  for (size_t i = 0; i < nvr; i++) needed += size_of(ours, vr[i]);
  return flex_misfits(ours, call, "values", values, n_values, needed);
}

// how many of the next variables are plain reals: the backend takes them as an array
static size_t plain(const fmi3ValueReference *vr, size_t nvr) {
  size_t count = 0;
  while (count < nvr && FLEX_SORT_OF(vr[count]) == FLEX_REAL) count++;
  return count;
}

static fmi3Status unknown(const flex_instance *ours, fmi3ValueReference reference) {
  return flex_log(ours, fmi3Error, LOG_ERROR, "value reference %u is unknown, or its variable is of another type", reference);
}

// the time, an event indicator, the derivatives of an input or all states
static fmi3Status get_other(flex_instance *ours, fmi3ValueReference reference, fmi3Float64 *values) {
  flex_backend *backend = ours->backend;
  unsigned sort = FLEX_SORT_OF(reference), index = FLEX_INDEX_OF(reference);
  if (sort == FLEX_TIME && index == 0) {
    *values = *backend->time;
  } else if (sort == FLEX_INDICATOR && index < flex_backend_indicators()) {
    if (flex_backend_get_indicators(backend, ours->scratch)) return flex_log_refusal(ours);
    *values = ours->scratch[index];
  } else if (sort == FLEX_INPUT_DERIVATIVES && index < backend->n_inputs) {
    for (int order = backend->max_input_order; order > 0; order--)
      values[order - 1] = flex_backend_input_derivative(backend, index, order);
  } else if (sort == FLEX_STATES && index < 2 && flex_backend_states() > 0) {
    int refused = index ? flex_backend_get_state_rates(backend, values) : flex_backend_get_states(backend, values);
    if (refused) return flex_log_refusal(ours);
  } else {
    return unknown(ours, reference);
  }
  return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues) {
  const fmi3ValueReference *vr = valueReferences;
  flex_instance *ours = flex_checked(instance, call_fmi3GetFloat64);
  if (!ours || lacks_values(ours, call_fmi3GetFloat64, vr, nValueReferences, values, nValues) ||
      flex_reads_too_early(ours, vr, nValueReferences))
    return fmi3Error;
  for (size_t i = 0; i < nValueReferences;) {
    size_t count = plain(vr + i, nValueReferences - i);
    if (count && flex_backend_get_reals(ours->backend, vr + i, count, values)) return flex_log_refusal(ours);
    if (!count && get_other(ours, vr[i], values) != fmi3OK) return fmi3Error;
    values += count ? count : size_of(ours, vr[i]);
    i += count ? count : 1;
  }
  return fmi3OK;
}

// derivatives of an input; zeros that are there already are left, so that the polynomial gets no higher
static fmi3Status set_derivatives(flex_instance *ours, fmi3ValueReference reference, const fmi3Float64 *values) {
  unsigned input = FLEX_INDEX_OF(reference);
  if (FLEX_SORT_OF(reference) != FLEX_INPUT_DERIVATIVES || input >= ours->backend->n_inputs)
    return flex_log(ours, fmi3Error, LOG_ERROR, "value reference %u is neither an input nor a parameter, it cannot be set",
                    reference);
  for (int order = 1; order <= ours->backend->max_input_order; order++) {
    double value = values[order - 1];
    if (value == 0.0 && flex_backend_input_derivative(ours->backend, input, order) == 0.0) continue;
    if (flex_backend_set_input_derivatives(ours->backend, &input, 1, &order, &value)) return flex_log_refusal(ours);
  }
  return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues) {
  const fmi3ValueReference *vr = valueReferences;
  flex_instance *ours = flex_checked(instance, call_fmi3SetFloat64);
  if (!ours || lacks_values(ours, call_fmi3SetFloat64, vr, nValueReferences, values, nValues)) return fmi3Error;
  const int asks = ours->session.phase == INPUT_UPDATE, inputs_only = asks || ours->session.phase == CONTINUOUS_TIME_MODE;
  for (size_t i = 0; i < nValueReferences; i++)
    if (inputs_only && (asks || FLEX_SORT_OF(vr[i]) != FLEX_INPUT_DERIVATIVES) && vr[i] >= ours->backend->n_inputs)
      return flex_log(ours, fmi3Error, LOG_ERROR, "value reference %u is no input, it cannot be set in this mode", vr[i]);
  for (size_t i = 0; i < nValueReferences; values += size_of(ours, vr[i]), i++) {
    if (asks) {
      ours->asked[vr[i]] = *values;
    } else if (FLEX_SORT_OF(vr[i]) != FLEX_REAL) {
      if (set_derivatives(ours, vr[i], values) != fmi3OK) return fmi3Error;
    } else if (flex_backend_set_real(ours->backend, vr[i], *values)) {
      return flex_log_refusal(ours);
    }
  }
  return fmi3OK;
}

// numbered choices are Int32, or enumerations and thus Int64; their values are those of an int
static int get_integer(flex_instance *ours, fmi3ValueReference reference, int *value) {
  if (FLEX_SORT_OF(reference) != FLEX_INTEGER) return unknown(ours, reference) != fmi3OK;
  int is_refused = flex_backend_get_integer(ours->backend, FLEX_INDEX_OF(reference), value);
  return is_refused ? flex_log_refusal(ours) != fmi3OK : 0;
}

static int set_integer(flex_instance *ours, fmi3ValueReference reference, fmi3Int64 value) {
  if (FLEX_SORT_OF(reference) != FLEX_INTEGER) return unknown(ours, reference) != fmi3OK;
  int fits = value < INT_MIN ? INT_MIN : value > INT_MAX ? INT_MAX : (int)value;
  int is_refused = flex_backend_set_integer(ours->backend, FLEX_INDEX_OF(reference), fits);
  return is_refused ? flex_log_refusal(ours) != fmi3OK : 0;
}

#define INTEGERS(bits)                                                                                                      \
  fmi3Status fmi3GetInt##bits(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,   \
                              fmi3Int##bits values[], size_t nValues) {                                                     \
    const flex_call_id call = call_fmi3GetInt##bits;                                                                        \
    flex_instance *ours = flex_checked(instance, call);                                                                     \
    if (!ours || lacks_values(ours, call, valueReferences, nValueReferences, values, nValues)) return fmi3Error;            \
    for (size_t i = 0; i < nValueReferences; i++) {                                                                         \
      int value = 0;                                                                                                        \
      if (get_integer(ours, valueReferences[i], &value)) return fmi3Error;                                                  \
      values[i] = value;                                                                                                    \
    }                                                                                                                       \
    return fmi3OK;                                                                                                          \
  }                                                                                                                         \
  fmi3Status fmi3SetInt##bits(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,   \
                              const fmi3Int##bits values[], size_t nValues) {                                               \
    const flex_call_id call = call_fmi3SetInt##bits;                                                                        \
    flex_instance *ours = flex_checked(instance, call);                                                                     \
    if (!ours || lacks_values(ours, call, valueReferences, nValueReferences, values, nValues)) return fmi3Error;            \
    for (size_t i = 0; i < nValueReferences; i++)                                                                           \
      if (set_integer(ours, valueReferences[i], values[i])) return fmi3Error;                                               \
    return fmi3OK;                                                                                                          \
  }

INTEGERS(32)
INTEGERS(64)

// the transpose of the directional derivatives: one pass for each known variable
fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                    fmi3Float64 sensitivity[], size_t nSensitivity) {
  const flex_call_id call = call_fmi3GetAdjointDerivative;
  const double one = 1.0;
  flex_instance *ours = flex_checked(instance, call);
  flex_direction column = {nKnowns, nUnknowns, knowns, unknowns, &one, NULL};
  if (!ours || flex_lacks_derivatives(ours, call, &column, seed, nSeed, nUnknowns, sensitivity, nSensitivity, nKnowns))
    return fmi3Error;
  column.n_known = 1;
  column.result = ours->scratch;
  for (size_t k = 0; k < nKnowns; k++, column.known++) {
    double sum = 0.0;
    // as many unknowns at once as there are outputs
    for (size_t first = 0; first < nUnknowns; first += column.n_unknown) {
      size_t left = nUnknowns - first, room = (size_t)ours->backend->n_outputs + 1;
      column.unknown = unknowns + first;
      column.n_unknown = left < room ? left : room;
      if (flex_backend_differentiate(ours->backend, &column)) return flex_log_refusal(ours);
      for (size_t i = 0; i < column.n_unknown; i++) sum += seed[first + i] * column.result[i];
    }
    sensitivity[k] = sum;
  }
  return fmi3OK;
}

/* Derivatives of outputs and directional derivatives. In FMI 3.0 the number of values follows each array. */
#include "instance.h"

int flex_reads_too_early(const flex_instance *instance, const fmi2ValueReference *references, size_t count) {
  unsigned first = instance->backend->n_settable, end = first + instance->backend->n_outputs;
  for (size_t i = 0; i < count && instance->session.phase == INSTANTIATED; i++) {
    if ((references[i] < first || references[i] >= end) && !FLEX_IS_COMPUTED(references[i])) continue;
    flex_log(instance, fmi2Error, LOG_ERROR, "outputs cannot be read before fmi2EnterInitializationMode");
    return 1;
  }
  return 0;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                        fmi2Real value[] FLEX_COUNT(n_values)) {
  const flex_call_id call = call_fmi2GetRealOutputDerivatives;
  flex_instance *instance = flex_checked(c, call);
  if (!instance || flex_lacks(instance, call, "value references", vr, nvr) ||
      flex_misfits(instance, call, "values", value, FLEX_COUNTED(n_values, nvr), nvr) ||
      flex_lacks(instance, call, "orders", order, nvr))
    return fmi2Error;
  int refused = flex_backend_get_output_derivatives(instance->backend, vr, nvr, order, value);
  return refused ? flex_log_refusal(instance) : fmi2OK;
}

int flex_lacks_derivatives(const flex_instance *instance, flex_call_id call, const flex_direction *direction, const double *seed,
                           size_t n_seed, size_t seeds, const double *result, size_t n_result, size_t results) {
  return flex_lacks(instance, call, "value references of unknowns", direction->unknown, direction->n_unknown) ||
         flex_lacks(instance, call, "value references of knowns", direction->known, direction->n_known) ||
         flex_misfits(instance, call, "seeds", seed, n_seed, seeds) ||
         flex_misfits(instance, call, "sensitivities", result, n_result, results);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t nUnknowns,
                                        const fmi2ValueReference knowns[], size_t nKnowns,
                                        const fmi2Real seed[] FLEX_COUNT(nSeed),
                                        fmi2Real sensitivity[] FLEX_COUNT(nSensitivity)) {
  const flex_call_id call = call_fmi2GetDirectionalDerivative;
  const flex_direction direction = {nKnowns, nUnknowns, knowns, unknowns, seed, sensitivity};
  flex_instance *instance = flex_checked(c, call);
  if (!instance || flex_lacks_derivatives(instance, call, &direction, seed, FLEX_COUNTED(nSeed, nKnowns), nKnowns, sensitivity,
                                          FLEX_COUNTED(nSensitivity, nUnknowns), nUnknowns))
    return fmi2Error;
  return flex_backend_differentiate(instance->backend, &direction) ? flex_log_refusal(instance) : fmi2OK;
}

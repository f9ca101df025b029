/* Values of variables, and derivatives of inputs. */
#include "instance.h"

// value references and values of so many variables
static int lacks_arrays(const flex_instance *instance, flex_call_id call, const void *vr, const void *value, size_t nvr) {
  return flex_lacks(instance, call, "value references", vr, nvr) || flex_lacks(instance, call, "values", value, nvr);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
  flex_instance *instance = flex_checked(c, call_fmi2GetReal);
  if (!instance || lacks_arrays(instance, call_fmi2GetReal, vr, value, nvr) || flex_reads_too_early(instance, vr, nvr))
    return fmi2Error;
  return flex_backend_get_reals(instance->backend, vr, nvr, value) ? flex_log_refusal(instance) : fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
  flex_instance *instance = flex_checked(c, call_fmi2SetReal);
  if (!instance || lacks_arrays(instance, call_fmi2SetReal, vr, value, nvr)) return fmi2Error;
  for (size_t i = 0; i < nvr; i++)
    if (instance->session.phase == CONTINUOUS_TIME_MODE && vr[i] >= instance->backend->n_inputs)
      return flex_log(instance, fmi2Error, LOG_ERROR,
                      "value reference %u is no input, it cannot be set in continuous-time mode", vr[i]);
  for (size_t i = 0; i < nvr; i++)
    if (flex_backend_set_real(instance->backend, vr[i], value[i])) return flex_log_refusal(instance);
  return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[]) {
  flex_instance *instance = flex_checked(c, call_fmi2GetInteger);
  if (!instance || lacks_arrays(instance, call_fmi2GetInteger, vr, value, nvr)) return fmi2Error;
  for (size_t i = 0; i < nvr; i++)
    if (flex_backend_get_integer(instance->backend, vr[i], &value[i])) return flex_log_refusal(instance);
  return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[]) {
  flex_instance *instance = flex_checked(c, call_fmi2SetInteger);
  if (!instance || lacks_arrays(instance, call_fmi2SetInteger, vr, value, nvr)) return fmi2Error;
  for (size_t i = 0; i < nvr; i++)
    if (flex_backend_set_integer(instance->backend, vr[i], value[i])) return flex_log_refusal(instance);
  return fmi2OK;
}

// there are no variables of the other types
static fmi2Status nothing_of_type(fmi2Component c, flex_call_id call, size_t nvr, const char *type) {
  flex_instance *instance = flex_checked(c, call);
  if (!instance) return fmi2Error;
  return nvr == 0 ? fmi2OK : flex_log(instance, fmi2Error, LOG_ERROR, "this FMU has no variables of type %s", type);
}

#define NOTHING(type)                                                                                                 \
  fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2##type value[]) {          \
    return (void)vr, (void)value, nothing_of_type(c, call_fmi2Get##type, nvr, #type);                                 \
  }                                                                                                                   \
  fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2##type value[]) {    \
    return (void)vr, (void)value, nothing_of_type(c, call_fmi2Set##type, nvr, #type);                                 \
  }

NOTHING(Boolean)
NOTHING(String)

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer order[],
                                       const fmi2Real value[]) {
  flex_instance *instance = flex_checked(c, call_fmi2SetRealInputDerivatives);
  if (!instance || lacks_arrays(instance, call_fmi2SetRealInputDerivatives, vr, value, nvr)) return fmi2Error;
  if (flex_lacks(instance, call_fmi2SetRealInputDerivatives, "orders", order, nvr)) return fmi2Error;
  int refused = flex_backend_set_input_derivatives(instance->backend, vr, nvr, order, value);
  return refused ? flex_log_refusal(instance) : fmi2OK;
}

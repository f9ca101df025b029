/* What model exchange has beyond FMI 2.0: numbers of states and event indicators. */
#include "instance.h"

static fmi3Status count(fmi3Instance instance, flex_call_id call, size_t *place, size_t number) {
  flex_instance *ours = flex_checked(instance, call);
  if (!ours || flex_lacks(ours, call, "a place for the number", place, 1)) return fmi3Error;
  *place = number;
  return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators) {
  return count(instance, call_fmi3GetNumberOfEventIndicators, nEventIndicators, flex_backend_indicators());
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates) {
  return count(instance, call_fmi3GetNumberOfContinuousStates, nContinuousStates, flex_backend_states());
}

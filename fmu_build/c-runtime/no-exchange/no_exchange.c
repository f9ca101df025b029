/* What is the same for all that have no continuous states: of model_exchange.h only the counts are called, everything follows from
 * the numeric state, tolerances don't matter, and there are no directional derivatives. */
#include "model_exchange.h"
#include "refusal.h"

int flex_backend_has_model_exchange(void) { return 0; }
size_t flex_backend_states(void) { return 0; }
size_t flex_backend_indicators(void) { return 0; }
void flex_backend_set_time(flex_backend *backend, double time) { (void)backend, (void)time; }
void flex_backend_set_states(flex_backend *backend, const double *x) { (void)backend, (void)x; }
int flex_backend_get_states(flex_backend *backend, double *x) { return (void)backend, (void)x, 0; }
int flex_backend_get_state_rates(flex_backend *backend, double *rates) { return (void)backend, (void)rates, 0; }
int flex_backend_get_indicators(flex_backend *backend, double *indicators) { return (void)backend, (void)indicators, 0; }
int flex_backend_has_event(flex_backend *backend) { return (void)backend, 0; }
int flex_backend_check_point(flex_backend *backend) { return (void)backend, 0; }
double flex_backend_state_nominal(size_t index) { return (void)index, 1.0; }
void flex_backend_restored(flex_backend *backend) { (void)backend; }
double flex_backend_set_tolerance(flex_backend *backend, double tolerance) { return (void)backend, tolerance; }

int flex_backend_differentiate(flex_backend *backend, const flex_direction *direction) {
  (void)direction;
  return flex_refuse(backend->message, "this FMU provides no directional derivatives, as its model description says");
}

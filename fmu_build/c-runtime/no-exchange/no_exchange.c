/* The functions of model_exchange.h for what has no continuous states; only the counts are called. */
#include "model_exchange.h"

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

/* What the functions of model exchange ask of the thing inside the FMU; only plants have them. */
#ifndef FLEXFMU_MODEL_EXCHANGE_H
#define FLEXFMU_MODEL_EXCHANGE_H

#include "backend.h"

/* number of continuous states */
size_t flex_backend_states(void);

/* moves to a time and to finite states that the importer has integrated */
void flex_backend_set_time(flex_backend *backend, double time);
void flex_backend_set_states(flex_backend *backend, const double *x);

/* states and their time derivatives at the present point; 0, or 1 with a sentence in `message` */
int flex_backend_get_states(flex_backend *backend, double *x);
int flex_backend_get_state_rates(flex_backend *backend, double *rates);

/* number of event indicators; their values; 0, or 1 with a sentence in `message` */
size_t flex_backend_indicators(void);
int flex_backend_get_indicators(flex_backend *backend, double *indicators);

/* whether an event has happened at the present point */
int flex_backend_has_event(flex_backend *backend);

/* whether the motion may go on from the present point; 0, or 1 with a sentence in `message` */
int flex_backend_check_point(flex_backend *backend);

/* usual size of a state, positive */
double flex_backend_state_nominal(size_t index);

#endif

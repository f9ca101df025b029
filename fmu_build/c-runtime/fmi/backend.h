/* What the FMI layer asks of the thing inside the FMU: a plant, a discrete-time block or a trajectory.
 *
 * Each of these has a file <kind>_backend.c with all functions below; a binary links exactly one such file. Functions that
 * can be refused return 0, or 1 with a sentence in `message`. */
#ifndef FLEXFMU_BACKEND_H
#define FLEXFMU_BACKEND_H

#include <stddef.h>

/* what every kind begins with; only the kind itself writes here */
typedef struct flex_backend {
  void *state; /* numeric state without pointers, so that saving and restoring it is a copy */
  size_t state_size;
  const double *time;  /* present time [s], within the state */
  char *message;       /* why the last call was refused */
  unsigned n_inputs;   /* real variables below this value reference are inputs */
  unsigned n_settable; /* real variables below this value reference are inputs and parameters */
  unsigned n_outputs;  /* so many after them are outputs */
  int max_input_order; /* highest order of input derivatives, 0 = there are none */
  int (*tick)(struct flex_backend *backend); /* FMI 3.0: its clock ticks; NULL without one. 0, or 1 with a sentence in `message` */
} flex_backend;

/* what changes of known variables make of unknown ones */
typedef struct {
  size_t n_known, n_unknown;
  const unsigned *known, *unknown; /* value references */
  const double *change;            /* of the known variables */
  double *result;                  /* changes of the unknown ones */
} flex_direction;

/* identity of the model description that belongs to this binary */
const char *flex_backend_guid(void);

/* whether an importer may integrate it itself, by the functions of model_exchange.h */
int flex_backend_has_model_exchange(void);

/* bytes of memory that an instance needs, zeroed by the caller before flex_backend_create */
size_t flex_backend_size(void);
flex_backend *flex_backend_create(void *memory);

/* back to the start values of everything */
void flex_backend_reset(flex_backend *backend);

/* to be called after the numeric state was overwritten with a saved one */
void flex_backend_restored(flex_backend *backend);

/* before the motion: when it starts, and how accurate it shall be; returns the relative tolerance that is in use */
void flex_backend_set_start_time(flex_backend *backend, double time);
double flex_backend_set_tolerance(flex_backend *backend, double tolerance);

/* ends initialisation */
int flex_backend_begin(flex_backend *backend);

/* from t0 to t1; where it is refused, the backend is left at the time that it has reached. It handles its events, or ends at the
 * first of them if there is a place to say so */
int flex_backend_advance(flex_backend *backend, double t0, double t1, int *event);

/* an event, found by an importer that integrates or by a step that ended there: *states_changed = 1 if it changes the states, *next
 * becomes the time of the next one where it is known */
int flex_backend_handle_event(flex_backend *backend, int is_exchange, int *states_changed, double *next);

/* variables by value reference, with checks; where one is refused, nothing has changed. What importers ask for by dozens in
 * every step comes in arrays: those before the refused one are done */
int flex_backend_get_reals(flex_backend *backend, const unsigned *index, size_t count, double *value);
int flex_backend_set_real(flex_backend *backend, unsigned index, double value);
int flex_backend_get_integer(flex_backend *backend, unsigned index, int *value);
int flex_backend_set_integer(flex_backend *backend, unsigned index, int value);
int flex_backend_set_input_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                       const double *value);
int flex_backend_get_output_derivatives(flex_backend *backend, const unsigned *index, size_t count, const int *order,
                                        double *value);

/* the derivative of an input at the present time, of order 1 and above */
double flex_backend_input_derivative(flex_backend *backend, unsigned input, int order);

/* directional derivatives */
int flex_backend_differentiate(flex_backend *backend, const flex_direction *direction);

/* the work done since initialisation, a sentence for the log */
void flex_backend_summarise(flex_backend *backend, char *text, size_t size);

#endif

/* A plant in motion: parameters, inputs, state and outputs of one instance, evaluated on demand.
 *
 * Everything numerical lies in one piece of memory without pointers, so that saving and restoring it is a copy. */
#ifndef FLEXFMU_PLANT_H
#define FLEXFMU_PLANT_H

#include "integrator.h"
#include "inputs.h"
#include "model.h"
#include "outcome.h"
#include "refusal.h"
#include "statics.h"
#include "tangent.h"

/* what has been computed for the present values of everything that it depends on */
enum {
  FLEX_HAVE_DERIVED = 1 << 0,
  FLEX_HAVE_START = 1 << 1,
  FLEX_HAVE_ACCELERATION = 1 << 2,
  FLEX_HAVE_OUTPUTS = 1 << 3,
  FLEX_HAVE_FIRST_RATES = 1 << 4,
  FLEX_HAVE_SECOND_RATES = 1 << 5
};

/* the scalars of the numeric state */
typedef struct {
  double time, tolerance, fixed_step; /* [s], [1], [s]; fixed_step: 0 = the error decides */
  int method;        /* FLEX_AUTOMATIC or one of the other methods */
  int starts_static; /* 1 = static equilibrium, 0 = undeformed */
  int is_moving;     /* 1 = initialisation is over */
  int is_overdamped; /* 1 = at the start something decays far faster than it vibrates */
  int have;          /* FLEX_HAVE_.. */
  int inputs_changed;
  flex_integrator_record integrator;
  flex_stages_record stages;
} flex_plant_record;

typedef struct {
  const flex_model *model;
  flex_plant_record *record;
  size_t state_size; /* bytes of the numeric state, which begins with the record */

  /* numeric state; u, previous_u: inputs now and when the last communication step began */
  real *p, *d, *scale, *u, *previous_u, *outputs;
  int *modes; /* of frictions and events */
  double *forgiven; /* of the events */
  flex_inputs inputs;
  flex_integrator integrator;

  /* scratch; jerk da/dt, snap d2a/dt2, rates o1, o2 of the outputs, entries of do/da; what the first rates hand on to the second */
  real *jerk, *first_rates, *acceleration_entries, *snap, *second_rates, *shared;
  int rates_come_along; /* 1 = whoever asked for outputs has asked for their rates, too */
  flex_equations equations;
  flex_statics statics;
  real *u1, *u2, *zero;
  double *indicators;
  flex_tangent tangent;
  real *shown_u; /* inputs at the present time, after flex_plant_need_inputs */

  char message[FLEX_MESSAGE_SIZE]; /* why the last call was refused */
} flex_plant;

/* bytes of memory that an instance needs, zeroed by the caller before flex_plant_create */
size_t flex_plant_size(const flex_model *model);
flex_plant *flex_plant_create(const flex_model *model, void *memory);

/* whether results are there and nothing has changed since: every variable that is read asks */
static inline int flex_plant_has(const flex_plant *plant, int results) {
  const flex_plant_record *record = plant->record;
  return (record->have & results) == results && !record->inputs_changed;
}

/* back to the start values of everything */
void flex_plant_reset(flex_plant *plant);

/* before the motion: the time at which it starts */
void flex_plant_set_start_time(flex_plant *plant, double time);

/* to be called after the numeric state was overwritten with a saved one */
void flex_plant_restored(flex_plant *plant);

/* a changed parameter, input or choice of the start makes results stale */
void flex_plant_parameters_changed(flex_plant *plant);
void flex_plant_start_changed(flex_plant *plant);

static inline void flex_plant_inputs_changed(flex_plant *plant) {
  plant->record->inputs_changed = 1;
  if (!plant->record->is_moving) flex_plant_start_changed(plant);
}

/* the unknown that is the time, if there is one, at the plant's time */
void flex_plant_set_clock(flex_plant *plant);

/* the importer has moved coordinates and rates */
void flex_plant_moved(flex_plant *plant);

/* an event that the importer handles: chooses the modes of friction anew, and holds them from now on if it integrates itself;
 * *stopped = 1 if a coordinate that friction catches was stopped. The indicators of such events, one for each friction */
flex_failure flex_plant_settle(flex_plant *plant, int holds, int *stopped);
flex_failure flex_plant_indicators(flex_plant *plant, double *indicators);

/* whether one has happened at the present point */
int flex_plant_has_event(flex_plant *plant);

/* ends initialisation at the given time */
flex_failure flex_plant_begin(flex_plant *plant);

/* integrates from t0 to t1, or to the first event if the integrator stops there; the plant is left at the time that was reached */
flex_failure flex_plant_advance(flex_plant *plant, double t0, double t1);

/* the present inputs with zero rates, valid until the next call */
const real *flex_plant_inputs_at_rest(flex_plant *plant);

/* make valid: coordinates and rates at the start; accelerations; accelerations at a point that is not too singular */
flex_failure flex_plant_need_start(flex_plant *plant);
flex_failure flex_plant_need_acceleration(flex_plant *plant);
flex_failure flex_plant_need_admissible(flex_plant *plant);

/* make valid: inputs at the present time (also those never set), outputs, their rates up to order 1 or 2 */
flex_failure flex_plant_need_inputs(flex_plant *plant);
flex_failure flex_plant_need_outputs(flex_plant *plant);
flex_failure flex_plant_need_rates(flex_plant *plant, int order);

#endif

#include "state_space.h"

#include <string.h>

// bytes of the states that are coordinates, and of those that are rates
static size_t coordinate_size(const flex_plant *plant) {
  return (size_t)flex_state_coordinates(plant->model) * sizeof(double);
}

static size_t rate_size(const flex_plant *plant) {
  return (size_t)flex_state_rates(plant->model) * sizeof(double);
}

void flex_state_space_set_time(flex_plant *plant, double time) {
  plant->record->time = time;
  if (!plant->model->has_clock) return;
  flex_plant_set_clock(plant);
  flex_plant_moved(plant);
}

void flex_state_space_set(flex_plant *plant, const double *x) {
  flex_integrator *integrator = &plant->integrator;
  size_t size = (size_t)plant->model->n * sizeof(double);
  memcpy(integrator->y, x, coordinate_size(plant));
  memcpy(integrator->v, x + flex_state_coordinates(plant->model), rate_size(plant));
  memset(integrator->y_rest, 0, size);
  memset(integrator->v_rest, 0, size);

  // the acceleration shall not depend on what was evaluated before, not even by its last digit
  memset(integrator->a, 0, size);
  flex_plant_moved(plant);
}

flex_failure flex_state_space_get(flex_plant *plant, double *x) {
  flex_failure failure = flex_plant_need_start(plant);
  if (failure.outcome != FLEX_DONE) return failure;
  memcpy(x, plant->integrator.y, coordinate_size(plant));
  memcpy(x + flex_state_coordinates(plant->model), plant->integrator.v, rate_size(plant));
  return failure;
}

flex_failure flex_state_space_rates(flex_plant *plant, double *rates) {
  flex_failure failure = flex_plant_need_admissible(plant);
  if (failure.outcome != FLEX_DONE) return failure;
  memcpy(rates, plant->integrator.v, coordinate_size(plant));
  memcpy(rates + flex_state_coordinates(plant->model), plant->integrator.a, rate_size(plant));
  return failure;
}

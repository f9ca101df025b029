#include "state_space.h"

#include <string.h>

void flex_state_space_set_time(flex_plant *plant, double time) {
  plant->record->time = time;
}

void flex_state_space_set(flex_plant *plant, const double *x) {
  flex_integrator *integrator = &plant->integrator;
  size_t n = (size_t)plant->model->n, size = n * sizeof(double);
  memcpy(integrator->y, x, size);
  memcpy(integrator->v, x + n, size);
  memset(integrator->y_rest, 0, size);
  memset(integrator->v_rest, 0, size);

  // the acceleration shall not depend on what was evaluated before, not even by its last digit
  memset(integrator->a, 0, size);
  flex_plant_moved(plant);
}

flex_failure flex_state_space_get(flex_plant *plant, double *x) {
  flex_failure failure = flex_plant_need_start(plant);
  size_t n = (size_t)plant->model->n, size = n * sizeof(double);
  if (failure.outcome != FLEX_DONE) return failure;
  memcpy(x, plant->integrator.y, size);
  memcpy(x + n, plant->integrator.v, size);
  return failure;
}

flex_failure flex_state_space_rates(flex_plant *plant, double *rates) {
  const flex_integrator *integrator = &plant->integrator;
  flex_failure failure = flex_plant_need_admissible(plant);
  size_t n = (size_t)plant->model->n, size = n * sizeof(double);
  if (failure.outcome != FLEX_DONE) return failure;
  memcpy(rates, integrator->v, size);
  memcpy(rates + n, integrator->a, size);
  return failure;
}

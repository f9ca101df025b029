#include "plants.h"

#include <string.h>

#include "check.h"

flex_plant *make_plant(const flex_model *model, double tolerance) {
  flex_plant *plant = flex_plant_create(model, calloc(1, flex_plant_size(model)));
  plant->record->tolerance = tolerance;
  return plant;
}

void free_plant(flex_plant *plant) {
  free(plant); // the plant lies at the beginning of its memory
}

void begin_at(flex_plant *plant, const double *y, const double *v) {
  plant->record->starts_static = 0;
  flex_plant_begin(plant); // which may fail at the undeformed position, the origin
  plant->record->is_moving = 1;
  memset(plant->integrator.a, 0, (size_t)plant->model->n * sizeof *y);
  memcpy(plant->integrator.y, y, (size_t)plant->model->n * sizeof *y);
  memcpy(plant->integrator.v, v, (size_t)plant->model->n * sizeof *v);
  flex_integrator_start(&plant->integrator);
  plant->record->have &= ~(FLEX_HAVE_ACCELERATION | FLEX_HAVE_OUTPUTS | FLEX_HAVE_FIRST_RATES | FLEX_HAVE_SECOND_RATES);
}

void begin_static(flex_plant *plant) {
  plant->record->starts_static = 1;
  flex_failure failure = flex_plant_begin(plant);
  CHECK(failure.outcome == FLEX_DONE);
}

void set_input(flex_plant *plant, int index, double value) {
  flex_inputs_set(&plant->inputs, index, plant->record->time, value);
  flex_plant_inputs_changed(plant);
}

void advance(flex_plant *plant, double start, double h, int count) {
  for (int k = 0; k < count; k++) {
    flex_failure failure = flex_plant_advance(plant, start + k * h, start + (k + 1) * h);
    CHECK(failure.outcome == FLEX_DONE);
  }
}

void begin_pulled(flex_plant *plant, double speed) {
  CHECK(flex_plant_begin(plant).outcome == FLEX_DONE);
  flex_inputs_set_derivative(&plant->inputs, 0, 0.0, 1, speed);
  flex_plant_inputs_changed(plant);
}

void advance_twice(flex_plant *plant, double start, double h, int count) {
  char *saved = malloc(2 * plant->state_size), *end = saved + plant->state_size;
  memcpy(saved, plant->record, plant->state_size);
  advance(plant, start, h, count);
  memcpy(end, plant->record, plant->state_size);
  memcpy(plant->record, saved, plant->state_size);
  flex_plant_restored(plant);
  advance(plant, start, h, count);
  CHECK(memcmp(end, plant->record, plant->state_size) == 0);
  free(saved);
}

double output(flex_plant *plant, int index) {
  flex_failure failure = flex_plant_need_outputs(plant);
  CHECK(failure.outcome == FLEX_DONE);
  return plant->outputs[index];
}

#include "tangent.h"

#include <string.h>

void flex_tangent_take(flex_tangent *tangent, const flex_model *model, flex_arena *arena) {
  size_t n = (size_t)model->n, m = (size_t)model->n_inputs, derived = (size_t)model->n_derived;
  tangent->p = flex_take_reals(arena, (size_t)model->n_parameters);
  tangent->d = flex_take_reals(arena, derived);
  tangent->y = flex_take_reals(arena, n);
  tangent->v = flex_take_reals(arena, n);
  tangent->u = flex_take_reals(arena, m);
  tangent->start = flex_take_reals(arena, derived + 2 * n);
  tangent->rest_u = flex_take_reals(arena, m);
  tangent->unit = flex_take_reals(arena, n);
  tangent->changes = flex_take_reals(arena, flex_changes_count(model));
}

static void clear(real *x, int count) {
  memset(x, 0, (size_t)count * sizeof *x);
}

void flex_tangent_clear(flex_tangent *tangent, const flex_model *model) {
  clear(tangent->p, model->n_parameters);
  clear(tangent->d, model->n_derived);
  clear(tangent->y, model->n);
  clear(tangent->v, model->n);
  clear(tangent->u, model->n_inputs);
}

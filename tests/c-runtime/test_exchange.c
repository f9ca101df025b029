/* States of FMUs for model exchange, without an FMU. */
#include <math.h>
#include <stdlib.h>

#include "check.h"
#include "exchange.h"
#include "tests.h"

/* height, rate, and a state that follows the height with 1e6 1/s */
typedef struct {
  double time, x[3], reach;
  int fails;
} ball;

static int set_time(void *c, double time) { ((ball *)c)->time = time; return 0; }
static int get_indicators(void *c, double *z, size_t m) { (void)m; z[0] = ((ball *)c)->x[0]; return 0; }

static int set_states(void *c, const double *x, size_t n) {
  for (size_t k = 0; k < n; k++) ((ball *)c)->x[k] = x[k];
  return 0;
}

static int get_states(void *c, double *x, size_t n) {
  for (size_t k = 0; k < n; k++) x[k] = ((ball *)c)->x[k];
  return 0;
}

static int get_nominals(void *c, double *x, size_t n) {
  (void)c;
  for (size_t k = 0; k < n; k++) x[k] = 1.0;
  return 0;
}

static int get_rates(void *c, double *f, size_t n) {
  ball *b = c;
  (void)n;
  f[0] = b->x[1], f[1] = -9.81, f[2] = 1e6 * (b->x[0] - b->x[2]);
  return b->fails ? 3 : b->time > b->reach + 0.02 ? 2 : 0;
}

static int completed(void *c, int no_set, int *enters, int *ends) {
  (void)no_set;
  ((ball *)c)->reach = ((ball *)c)->time;
  *enters = *ends = 0;
  return 0;
}

// a ball beside a fast state: bounces at the instants of the closed form, discarded evaluations, a failure
TEST(imported_states_meet_events) {
  ball b = {0.0, {1.0, 0.0, 1.0}, 0.0, 0};
  void *component = &b;
  flex_exchange e = {.component = &component, .set_time = set_time, .set_states = set_states, .get_states = get_states,
                     .get_nominals = get_nominals, .get_rates = get_rates, .get_indicators = get_indicators,
                     .completed = (void (*)(void))completed, .n = 3, .m = 1, .tolerance = 1e-8, .no_rollback = 1,
                     .memory = calloc(1, flex_exchange_size(3, 1))};
  int outcome = flex_exchange_begin(&e, 1), bounces = 0;
  double fall = sqrt(2.0 / 9.81), expected = fall, rate = 9.81 * fall;
  while (outcome == EXCHANGE_REACHED && e.time < 2.0) {
    outcome = flex_exchange_advance(&e, 2.0);
    if (outcome != EXCHANGE_EVENT) break;
    if (b.x[1] < 0.0) {
      CHECK_CLOSE(e.time, expected, 1e-12);
      b.x[1] *= -0.8, rate *= 0.8, bounces++;
      expected += 2.0 * rate / 9.81;
    }
    outcome = flex_exchange_begin(&e, 1);
  }
  CHECK(outcome == EXCHANGE_REACHED && bounces == 3);
  b.reach = -1.0;
  CHECK(flex_exchange_advance(&e, 3.0) == EXCHANGE_STUCK);
  b.fails = 1;
  CHECK(flex_exchange_advance(&e, 3.0) == EXCHANGE_FAILED && e.status == 3);
  free(e.memory);
}

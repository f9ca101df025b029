/* A ball on a stiff spring-like filter, integrated without an FMU: its bounces, discarded evaluations, a failure; for the sanitizers. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "exchange.h"

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

int main(void) {
  ball b = {0.0, {1.0, 0.0, 1.0}, 0.0, 0};
  void *component = &b;
  double absolute[3] = {1e-8, 1e-8, 1e-8}, nominal[3] = {1.0, 1.0, 1.0};
  int pivots[6];
  size_t size = master_exchange_size(3, 1);
  double *memory = calloc(size, sizeof *memory);
  master_exchange e = {&component, set_time, set_states, get_rates, get_indicators, (void (*)(void))completed, NULL, NULL, NULL, 0, NULL, NULL,
                       0, 0, 3, 1, 1e-8, 1e-12, 1, absolute, nominal, memory, pivots, {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0}, 0};
  int outcome = master_exchange_begin(&e, b.x, 1), bounces = 0;
  double fall = sqrt(2.0 / 9.81), expected = fall, rate = 9.81 * fall;
  while (outcome == EXCHANGE_REACHED && e.record.time < 2.0) {
    outcome = master_exchange_advance(&e, 2.0);
    if (outcome != EXCHANGE_EVENT) break;
    double x[3] = {b.x[0], b.x[1], b.x[2]};
    if (x[1] < 0.0) {
      if (fabs(e.record.time - expected) > 1e-12) return printf("bounce at %.17g s instead of %.17g s\n", e.record.time, expected), 1;
      x[1] *= -0.8, rate *= 0.8, bounces++;
      expected += 2.0 * rate / 9.81;
    }
    outcome = master_exchange_begin(&e, x, 1);
  }
  if (outcome != EXCHANGE_REACHED || bounces != 3) return printf("outcome %d after %d bounces\n", outcome, bounces), 1;
  b.reach = -1.0;
  if ((outcome = master_exchange_advance(&e, 3.0)) != EXCHANGE_STUCK) return printf("outcome %d\n", outcome), 1;
  b.fails = 1;
  if ((outcome = master_exchange_advance(&e, 3.0)) != EXCHANGE_FAILED || e.status != 3) return printf("outcome %d\n", outcome), 1;
  free(memory);
  return 0;
}

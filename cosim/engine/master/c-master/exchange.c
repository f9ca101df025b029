#include "exchange.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

enum { STAGES = 3, NEWTON_ITERATIONS = 6, WARNING = 1, DISCARD = 2 };

/* relative difference of lengths of steps that counts as none */
#define NEAR 1e-9

/* width of the interval in which an event is located, relative to the step, beside a few roundings of the time */
#define EVENT_WIDTH 1e-13

/* outcome of an evaluation that a shorter step may save */
enum { DISCARDED = -1 };

static const double ROOT = 2.449489742783178; /* of 6 */
static const double NODES[STAGES] = {0.15505102572168222, 0.6449489742783178, 1.0};
static const double ERROR[STAGES] = {-10.04880939982742, 1.3821427331607488, -0.3333333333333333};
static const double REAL = 3.637834252744496, COMPLEX[2] = {2.6810828736277523, -3.050430199247410};
static const double T[STAGES][STAGES] = {{0.09443876248897524, -0.14125529502095421, 0.03002919410514742},
                                         {0.25021312296533332, 0.20412935229379994, -0.38294211275726192},
                                         {1.0, 1.0, 0.0}};
static const double INVERSE_T[STAGES][STAGES] = {{4.17871859155190428, 0.32768282076106237, 0.52337644549944951},
                                                 {-4.17871859155190428, -0.32768282076106237, 0.47662355450055044},
                                                 {0.50287263494578682, -2.57192694985560522, 0.59603920482822492}};

static double larger(double a, double b) { return a > b ? a : b; }
static double smaller(double a, double b) { return a < b ? a : b; }
static double fourth_root(double x) { return sqrt(sqrt(x)); }

/* pieces of `memory`: first what a step taken back restores */
typedef struct {
  double *x, *f, *z, *old, *stages, *saved, *jacobian, *real, *complex, *w, *dw, *rates, *trial, *error, *indicators;
} pieces;

static size_t kept(const master_exchange *e) { return (3 + STAGES) * e->n + e->m; }

size_t master_exchange_size(size_t n, size_t m) { return 2 * ((3 + STAGES) * n + m) + 5 * n * n + (3 * STAGES + 5) * n + 3 * m; }

static pieces split(const master_exchange *e) {
  size_t n = e->n;
  pieces p;
  double *next = e->memory;
  p.x = next, next += n;
  p.f = next, next += n;
  p.z = next, next += e->m;
  p.old = next, next += n;
  p.stages = next, next += STAGES * n;
  p.saved = next, next += kept(e);
  p.jacobian = next, next += n * n;
  p.real = next, next += 2 * n * n;
  p.complex = next, next += 2 * n * n;
  p.w = next, next += STAGES * n;
  p.dw = next, next += (STAGES + 1) * n + e->m;
  p.rates = next, next += STAGES * n;
  p.trial = next, next += 2 * n;
  p.error = next, next += 2 * n;
  p.indicators = next;
  return p;
}

// time, inputs that aren't held, and states
static int place(master_exchange *e, double time, const double *x) {
  typedef int (*fmi2_call)(void *, const unsigned *, size_t, const double *);
  typedef int (*fmi3_call)(void *, const unsigned *, size_t, const double *, size_t);
  int status = e->set_time(*e->component, time);
  for (size_t g = 0; g < e->polynomials_count && status <= WARNING; g++) {
    const master_exchange_polynomials *u = e->polynomials + g;
    for (size_t k = 0; k < u->count; k++) {
      u->values[k] = 0.0;
      for (size_t i = u->powers; i-- > 0;) u->values[k] = u->values[k] * (time - u->begin) + u->coefficients[i * u->count + k];
    }
    if (e->is_fmi3)
      status = ((fmi3_call)e->set_real)(*e->component, u->references, u->references_count, u->values, u->count);
    else
      status = ((fmi2_call)e->set_real)(*e->component, u->references, u->references_count, u->values);
  }
  if (e->n > 0 && status <= WARNING) status = e->set_states(*e->component, x, e->n);
  return e->status = status;
}

static int outcome(master_exchange *e, int status, const double *values, size_t count) {
  e->status = status;
  if (status == DISCARD) return DISCARDED;
  if (status > WARNING) return EXCHANGE_FAILED;
  for (size_t k = 0; k < count; k++)
    if (!isfinite(values[k])) return DISCARDED;
  return EXCHANGE_REACHED;
}

static int rates(master_exchange *e, double time, const double *x, double *f) {
  if (e->n == 0) return EXCHANGE_REACHED;
  int status = place(e, time, x);
  if (status <= WARNING) status = e->get_rates(*e->component, f, e->n);
  return outcome(e, status, f, e->n);
}

static int indicators(master_exchange *e, double time, const double *x, double *z) {
  if (e->m == 0) return EXCHANGE_REACHED;
  int status = place(e, time, x);
  if (status <= WARNING) status = e->get_indicators(*e->component, z, e->m);
  return outcome(e, status, z, e->m);
}

// the derivatives of the rates with respect to the states, by the FMU or by differences
static int renew_jacobian(master_exchange *e, const pieces *p) {
  typedef int (*fmi2_call)(void *, const unsigned *, size_t, const unsigned *, size_t, const double *, double *);
  typedef int (*fmi3_call)(void *, const unsigned *, size_t, const unsigned *, size_t, const double *, size_t, double *, size_t);
  size_t n = e->n, r = e->references;
  double *column = p->rates, *seed = p->trial;
  int status = e->directional != NULL ? place(e, e->record.time, p->x) : 0;
  for (size_t k = 0; k < n; k++) {
    double delta = 1.0;
    if (e->directional != NULL) {
      memset(seed, 0, n * sizeof *seed);
      seed[k] = 1.0;
      if (status <= WARNING && e->is_fmi3)
        status = ((fmi3_call)e->directional)(*e->component, e->unknown, r, e->known, r, seed, n, column, n);
      else if (status <= WARNING)
        status = ((fmi2_call)e->directional)(*e->component, e->unknown, r, e->known, r, seed, column);
      int found = outcome(e, status, column, n);
      if (found != EXCHANGE_REACHED) return found;
    } else {
      memcpy(seed, p->x, n * sizeof *seed);
      delta = sqrt(DBL_EPSILON * larger(1e-5 * e->nominal[k], fabs(seed[k])) * e->nominal[k]);
      seed[k] += delta;
      delta = seed[k] - p->x[k];
      int found = rates(e, e->record.time, seed, column);
      if (found != EXCHANGE_REACHED) return found;
    }
    for (size_t i = 0; i < n; i++) p->jacobian[i * n + k] = e->directional != NULL ? column[i] : (column[i] - p->f[i]) / delta;
  }
  e->record.is_current = 1;
  e->record.is_stale = 0;
  e->record.factored = 0.0;
  return EXCHANGE_REACHED;
}

// LU factors with pivots of the complex matrix (a + b i) I - J
static int factor(size_t n, double a, double b, const double *jacobian, double *lu, int *pivots) {
  for (size_t k = 0; k < n * n; k++) lu[2 * k] = -jacobian[k], lu[2 * k + 1] = 0.0;
  for (size_t k = 0; k < n; k++) lu[2 * k * (n + 1)] += a, lu[2 * k * (n + 1) + 1] += b;
  for (size_t k = 0; k < n; k++) {
    size_t best = k;
    double size = -1.0;
    for (size_t i = k; i < n; i++) {
      double own = fabs(lu[2 * (i * n + k)]) + fabs(lu[2 * (i * n + k) + 1]);
      if (own > size) best = i, size = own;
    }
    if (!(size > 0.0) || !isfinite(size)) return 1;
    pivots[k] = (int)best;
    double *row = lu + 2 * k * n, *other = lu + 2 * best * n;
    for (size_t j = 0; best != k && j < 2 * n; j++) {
      double swap = row[j];
      row[j] = other[j];
      other[j] = swap;
    }
    double re = row[2 * k], im = row[2 * k + 1], square = re * re + im * im;
    row[2 * k] = re / square, row[2 * k + 1] = -im / square; // the inverse of the pivot
    for (size_t i = k + 1; i < n; i++) {
      double *under = lu + 2 * i * n, x = under[2 * k], y = under[2 * k + 1];
      double l = x * row[2 * k] - y * row[2 * k + 1], m = x * row[2 * k + 1] + y * row[2 * k];
      under[2 * k] = l, under[2 * k + 1] = m;
      if (l == 0.0 && m == 0.0) continue;
      for (size_t j = k + 1; j < n; j++) {
        under[2 * j] -= l * row[2 * j] - m * row[2 * j + 1];
        under[2 * j + 1] -= l * row[2 * j + 1] + m * row[2 * j];
      }
    }
  }
  return 0;
}

static void solve(size_t n, const double *lu, const int *pivots, double *x) {
  for (size_t k = 0; k < n; k++) {
    size_t other = (size_t)pivots[k];
    double re = x[2 * other], im = x[2 * other + 1];
    x[2 * other] = x[2 * k], x[2 * other + 1] = x[2 * k + 1];
    x[2 * k] = re, x[2 * k + 1] = im;
  }
  for (size_t i = 0; i < n; i++)
    for (size_t j = 0; j < i; j++) {
      const double *l = lu + 2 * (i * n + j);
      x[2 * i] -= l[0] * x[2 * j] - l[1] * x[2 * j + 1];
      x[2 * i + 1] -= l[0] * x[2 * j + 1] + l[1] * x[2 * j];
    }
  for (size_t i = n; i-- > 0;) {
    for (size_t j = i + 1; j < n; j++) {
      const double *u = lu + 2 * (i * n + j);
      x[2 * i] -= u[0] * x[2 * j] - u[1] * x[2 * j + 1];
      x[2 * i + 1] -= u[0] * x[2 * j + 1] + u[1] * x[2 * j];
    }
    const double *d = lu + 2 * i * (n + 1);
    double re = x[2 * i], im = x[2 * i + 1];
    x[2 * i] = d[0] * re - d[1] * im, x[2 * i + 1] = d[0] * im + d[1] * re;
  }
}

// the last step's polynomial about its begin: what it adds to the states there
static double polynomial(const pieces *p, size_t n, size_t k, double theta) {
  double z0 = p->stages[k], z1 = p->stages[n + k], z2 = p->stages[2 * n + k];
  double q0 = (13.0 + 7.0 * ROOT) / 3.0 * z0 + (13.0 - 7.0 * ROOT) / 3.0 * z1 + z2 / 3.0;
  double q1 = (-23.0 - 22.0 * ROOT) / 3.0 * z0 + (-23.0 + 22.0 * ROOT) / 3.0 * z1 - 8.0 / 3.0 * z2;
  double q2 = (10.0 + 15.0 * ROOT) / 3.0 * z0 + (10.0 - 15.0 * ROOT) / 3.0 * z1 + 10.0 / 3.0 * z2;
  return theta * (q0 + theta * (q1 + theta * q2));
}

// Newton's iteration for the stages of a step of length h, from those in `stages`; rate and number of iterations
static int solve_stages(master_exchange *e, const pieces *p, double h, double *rate, int *count) {
  size_t n = e->n;
  double tolerance = larger(10.0 * DBL_EPSILON / e->tolerance, smaller(0.03, sqrt(e->tolerance))), before = 0.0;
  for (int i = 0; i < STAGES; i++)
    for (size_t k = 0; k < n; k++)
      p->w[i * n + k] = INVERSE_T[i][0] * p->stages[k] + INVERSE_T[i][1] * p->stages[n + k] + INVERSE_T[i][2] * p->stages[2 * n + k];
  *rate = 0.0;
  for (*count = 1; *count <= NEWTON_ITERATIONS; ++*count) {
    for (int i = 0; i < STAGES; i++) {
      for (size_t k = 0; k < n; k++) p->trial[k] = p->x[k] + p->stages[i * n + k];
      int found = rates(e, e->record.time + NODES[i] * h, p->trial, p->rates + i * n);
      if (found != EXCHANGE_REACHED) return found;
    }
    double *real = p->trial, *complex = p->error, sum = 0.0;
    for (size_t k = 0; k < n; k++) {
      double f0 = p->rates[k], f1 = p->rates[n + k], f2 = p->rates[2 * n + k], w1 = p->w[n + k], w2 = p->w[2 * n + k];
      real[2 * k] = INVERSE_T[0][0] * f0 + INVERSE_T[0][1] * f1 + INVERSE_T[0][2] * f2 - REAL / h * p->w[k];
      real[2 * k + 1] = 0.0;
      complex[2 * k] = INVERSE_T[1][0] * f0 + INVERSE_T[1][1] * f1 + INVERSE_T[1][2] * f2 - (COMPLEX[0] * w1 - COMPLEX[1] * w2) / h;
      complex[2 * k + 1] = INVERSE_T[2][0] * f0 + INVERSE_T[2][1] * f1 + INVERSE_T[2][2] * f2 - (COMPLEX[0] * w2 + COMPLEX[1] * w1) / h;
    }
    solve(n, p->real, e->pivots, real);
    solve(n, p->complex, e->pivots + n, complex);
    for (size_t k = 0; k < n; k++) {
      double scale = e->absolute[k] + e->tolerance * fabs(p->x[k]);
      double d[STAGES] = {real[2 * k], complex[2 * k], complex[2 * k + 1]};
      for (int i = 0; i < STAGES; i++) sum += (d[i] / scale) * (d[i] / scale), p->w[i * n + k] += d[i];
    }
    double size = sqrt(sum / (double)(STAGES * n));
    if (!isfinite(size)) return DISCARDED;
    for (int i = 0; i < STAGES; i++)
      for (size_t k = 0; k < n; k++)
        p->stages[i * n + k] = T[i][0] * p->w[k] + T[i][1] * p->w[n + k] + T[i][2] * p->w[2 * n + k];
    if (*count > 1) *rate = size / before;
    if (size == 0.0 || (*count > 1 && *rate < 1.0 && *rate / (1.0 - *rate) * size < tolerance)) return EXCHANGE_REACHED;
    // what the iterations that are left make of it
    double expected = size / (1.0 - *rate);
    for (int k = *count; k < NEWTON_ITERATIONS; k++) expected *= *rate;
    if (*rate >= 1.0 || (*count > 1 && expected > tolerance)) return DISCARDED;
    before = size;
  }
  return DISCARDED;
}

static double norm(const master_exchange *e, const double *x, const double *a, const double *b, size_t stride) {
  double sum = 0.0;
  for (size_t k = 0; k < e->n; k++) {
    double own = x[stride * k] / (e->absolute[k] + e->tolerance * larger(fabs(a[k]), fabs(b[k])));
    sum += own * own;
  }
  return sqrt(sum / (double)e->n);
}

// length of the first step, from two evaluations (Hairer, Norsett, Wanner: Solving Ordinary Differential Equations I, section II.4)
static int first_step(master_exchange *e, const pieces *p) {
  double d0 = norm(e, p->x, p->x, p->x, 1), d1 = norm(e, p->f, p->x, p->x, 1), h = d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1;
  for (size_t k = 0; k < e->n; k++) p->trial[k] = p->x[k] + h * p->f[k];
  int found = rates(e, e->record.time + h, p->trial, p->rates);
  if (found == EXCHANGE_FAILED) return found;
  for (size_t k = 0; k < e->n; k++) p->rates[k] -= p->f[k];
  double largest = larger(d1, found == EXCHANGE_REACHED ? norm(e, p->rates, p->x, p->x, 1) / h : 0.0);
  double other = largest <= 1e-15 ? larger(1e-6, 1e-3 * h) : fourth_root(0.01 / largest);
  e->record.step = found == EXCHANGE_REACHED ? smaller(100.0 * h, other) : h;
  return EXCHANGE_REACHED;
}

// one step whose error is within the tolerance, at most up to `bound`
static int make_step(master_exchange *e, const pieces *p, double bound) {
  master_exchange_record *r = &e->record;
  size_t n = e->n;
  double start = r->time, wanted = r->step, *former = p->dw;
  int again = 0;
  if (n == 0) {
    r->begin = start, r->time = bound;
    return EXCHANGE_REACHED;
  }
  if (r->is_stale) {
    int found = renew_jacobian(e, p);
    if (found != EXCHANGE_REACHED) return found == DISCARDED ? EXCHANGE_STUCK : found;
  }
  memcpy(former, p->stages, STAGES * n * sizeof *former);
  for (;;) {
    int clipped = start + (1.0 + NEAR) * wanted >= bound, count;
    double h = clipped ? bound - start : wanted, rate, end = clipped ? bound : start + h;
    if (again && h <= larger(e->least, 16.0 * DBL_EPSILON * fabs(start))) return EXCHANGE_STUCK;
    again = 1;
    // factors of the matrices for this length
    if (fabs(h - r->factored) > NEAR * h) {
      int singular = factor(n, REAL / h, 0.0, p->jacobian, p->real, e->pivots) ||
                     factor(n, COMPLEX[0] / h, COMPLEX[1] / h, p->jacobian, p->complex, e->pivots + n);
      r->factored = singular ? 0.0 : h;
      wanted = singular ? 0.5 * h : wanted;
      if (singular) continue;
    }
    // stages as the last step's polynomial predicts them
    memcpy(p->stages, former, STAGES * n * sizeof *former);
    for (size_t k = 0; k < n; k++) {
      double z[STAGES] = {0.0, 0.0, 0.0};
      for (int i = 0; i < STAGES && r->last > 0.0; i++)
        z[i] = polynomial(p, n, k, 1.0 + NODES[i] * h / r->last) - polynomial(p, n, k, 1.0);
      for (int i = 0; i < STAGES; i++) p->stages[i * n + k] = z[i];
    }
    int found = solve_stages(e, p, h, &rate, &count);
    if (found == EXCHANGE_FAILED) return found;
    if (found == DISCARDED) {
      // with a new Jacobian, or else half as far
      if (r->is_current)
        wanted = 0.5 * h;
      else if ((found = renew_jacobian(e, p)) == EXCHANGE_FAILED)
        return found;
      else if (found == DISCARDED)
        return EXCHANGE_STUCK;
      continue;
    }
    // the embedded error of order 3, filtered, and once more after a rejection
    double *next = p->w, error = 0.0;
    for (int pass = 0; pass < 2; pass++) {
      const double *f = p->f;
      if (pass == 1) {
        if (!(error > 1.0)) break;
        for (size_t k = 0; k < n; k++) p->dw[STAGES * n + k] = p->x[k] + p->error[2 * k];
        found = rates(e, start, p->dw + STAGES * n, p->rates);
        if (found == EXCHANGE_FAILED) return found;
        if (found == DISCARDED) break;
        f = p->rates;
      }
      for (size_t k = 0; k < n; k++) {
        double z = ERROR[0] * p->stages[k] + ERROR[1] * p->stages[n + k] + ERROR[2] * p->stages[2 * n + k];
        next[k] = p->x[k] + p->stages[2 * n + k];
        p->error[2 * k] = f[k] + z / h, p->error[2 * k + 1] = 0.0;
      }
      solve(n, p->real, e->pivots, p->error);
      error = norm(e, p->error, p->x, next, 2);
    }
    // the next length by the errors of both steps (Gustafsson)
    double factor_of = 1.0 / fourth_root(larger(error, 1e-10)), safety = 0.9 * (2.0 * NEWTON_ITERATIONS + 1.0) / (2.0 * NEWTON_ITERATIONS + count);
    if (r->last > 0.0 && r->last_error > 0.0) factor_of *= smaller(1.0, h / r->last * fourth_root(r->last_error / larger(error, 1e-10)));
    if (!(error <= 1.0)) {
      wanted = h * larger(0.2, isfinite(error) ? safety * factor_of : 0.0);
      continue;
    }
    found = rates(e, end, next, p->rates);
    if (found == EXCHANGE_FAILED) return found;
    if (found == DISCARDED) {
      wanted = 0.5 * h;
      continue;
    }
    factor_of = smaller(10.0, safety * factor_of);
    r->is_stale = count > 2 && rate > 1e-3;
    r->is_current = 0;
    // a bound says nothing about what the error admits
    double admitted = !r->is_stale && factor_of < 1.2 && factor_of >= 1.0 ? h : h * factor_of;
    r->step = clipped ? larger(admitted, r->step) : admitted;
    r->last = h, r->last_error = error;
    r->begin = start, r->time = end;
    memcpy(p->old, p->x, n * sizeof *p->x);
    memcpy(p->x, next, n * sizeof *p->x);
    memcpy(p->f, p->rates, n * sizeof *p->f);
    return EXCHANGE_REACHED;
  }
}

// indicators at a part of the last step
static int within(master_exchange *e, const pieces *p, double time, double *z) {
  double length = e->record.time - e->record.begin;
  for (size_t k = 0; k < e->n; k++)
    p->trial[k] = time == e->record.time ? p->x[k] : p->old[k] + polynomial(p, e->n, k, (time - e->record.begin) / length);
  return indicators(e, time, p->trial, z);
}

static int changes(const master_exchange *e, const double *before, const double *z) {
  for (size_t j = 0; j < e->m; j++)
    if ((before[j] > 0.0) != (z[j] > 0.0)) return 1;
  return 0;
}

/* The time just after the first change of an indicator's domain, z > 0 or z <= 0, in the last step; its end if there is none.
 * Indicators are read at the stages, so that two changes of one are seen in between; then the interval is narrowed by the Illinois
 * form of the regula falsi for the indicator that seems to change first. */
static int first_crossing(master_exchange *e, const pieces *p, double width, double *crossing, int *found_one) {
  double begin = e->record.begin, end = e->record.time, low = begin, high = end, weight = 1.0;
  double *at_low = p->indicators, *at_high = p->indicators + e->m, *at = p->dw + (STAGES + 1) * e->n;
  int side = 0, found;
  memcpy(at_low, p->z, e->m * sizeof *at_low);
  *found_one = 0, *crossing = end;
  for (int i = 0; i < STAGES && !*found_one; i++) {
    high = i == STAGES - 1 ? end : begin + NODES[i] * (end - begin);
    if ((found = within(e, p, high, at_high)) != EXCHANGE_REACHED) return found;
    *found_one = changes(e, p->z, at_high);
    if (!*found_one) low = high, memcpy(at_low, at_high, e->m * sizeof *at_low);
  }
  if (!*found_one) return EXCHANGE_REACHED;
  while (high - low > width) {
    double part = 1.0;
    for (size_t j = 0; j < e->m; j++)
      if ((p->z[j] > 0.0) != (at_high[j] > 0.0))
        part = smaller(part, weight * fabs(at_low[j]) / (weight * fabs(at_low[j]) + fabs(at_high[j]) + DBL_MIN));
    double middle = smaller(larger(low + part * (high - low), low + 0.5 * width), high - 0.5 * width);
    if ((found = within(e, p, middle, at)) != EXCHANGE_REACHED) return found;
    int before = side;
    side = changes(e, p->z, at) ? 1 : -1;
    memcpy(side > 0 ? at_high : at_low, at, e->m * sizeof *at);
    *(side > 0 ? &high : &low) = middle;
    weight = side != before ? 1.0 : side > 0 ? 0.5 * weight : 2.0 * weight;
  }
  *crossing = high;
  return EXCHANGE_REACHED;
}

int master_exchange_begin(master_exchange *e, const double *x, int anew) {
  pieces p = split(e);
  master_exchange_record *r = &e->record;
  memcpy(p.x, x, e->n * sizeof *x);
  r->last = 0.0, r->is_current = 0, r->begin = r->time;
  int found = rates(e, r->time, p.x, p.f);
  if (found == EXCHANGE_REACHED && anew && e->n > 0) {
    r->is_stale = 1, r->factored = 0.0;
    found = first_step(e, &p);
  }
  if (found == EXCHANGE_REACHED) found = indicators(e, r->time, p.x, p.z);
  if (found == EXCHANGE_REACHED && place(e, r->time, p.x) > WARNING) found = EXCHANGE_FAILED;
  return found == DISCARDED ? EXCHANGE_STUCK : found;
}

int master_exchange_advance(master_exchange *e, double bound) {
  typedef int (*fmi2_call)(void *, int, int *, int *);
  typedef int (*fmi3_call)(void *, bool, bool *, bool *);
  pieces p = split(e);
  while (e->record.time < bound) {
    master_exchange_record before = e->record;
    double target = bound, crossing;
    int event = 0, found;
    memcpy(p.saved, e->memory, kept(e) * sizeof *p.saved);
    for (;;) {
      if ((found = make_step(e, &p, target)) != EXCHANGE_REACHED) return found;
      double width = EVENT_WIDTH * (e->record.time - e->record.begin) + 8.0 * DBL_EPSILON * fabs(e->record.time);
      found = first_crossing(e, &p, width, &crossing, &event);
      if (found == EXCHANGE_FAILED) return found;
      if (found == EXCHANGE_REACHED && e->record.time - crossing <= width) break;
      // once more up to there, or half as far if the indicators are discarded
      double end = e->record.time, factored = e->record.factored;
      memcpy(e->memory, p.saved, kept(e) * sizeof *p.saved);
      e->record = before;
      e->record.factored = factored;
      target = found == DISCARDED ? before.time + 0.5 * (end - before.time) : crossing;
      if (found == DISCARDED && target - before.time <= e->least) return EXCHANGE_STUCK;
    }
    // the FMU at the end of the step
    if ((found = indicators(e, e->record.time, p.x, p.z)) == EXCHANGE_FAILED) return found;
    if (place(e, e->record.time, p.x) > WARNING) return EXCHANGE_FAILED;
    int enters = 0, ends = 0;
    if (e->completed != NULL && e->is_fmi3) {
      bool enter = false, end = false;
      e->status = ((fmi3_call)e->completed)(*e->component, e->no_rollback != 0, &enter, &end);
      enters = enter, ends = end;
    } else if (e->completed != NULL) {
      e->status = ((fmi2_call)e->completed)(*e->component, e->no_rollback, &enters, &ends);
    }
    if (e->status > WARNING) return EXCHANGE_FAILED;
    if (ends) return EXCHANGE_ENDS;
    if (event || enters) return EXCHANGE_EVENT;
  }
  return EXCHANGE_REACHED;
}

/* Other people's integrators on the generated functions of an FMU: Hairer and Wanner's RADAU5, and IDA and ARKODE of SUNDIALS, with
 * exact Jacobians and all outputs at the recorded instants. They restart where inputs jump.
 *
 * RADAU5 takes the equations in two forms: explicit, v' = -M^-1 b, and of index 1 with the accelerations as unknowns, where a step
 * needs no mass matrix; both with the structure y' = v that halves its linear systems (M1). */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "inputs.h"
#include "linear_algebra.h"
#include "plant.h"

#define MOST 64            /* unknowns */
#define LENGTH 1e-4        /* usual size of a deflection [m]: tolerances are relative to it */
#define EXPORTED __attribute__((visibility("default")))

/* generated beside the FMU's functions: (y, v, a, u, d) -> [dr/dy, dr/dv] by columns */
int peer_jacobian(const double **arg, double **res, int *iw, double *w, int mem);

enum { EXPLICIT_RADAU, INDEX_1_RADAU, IDA, ARKODE };

/* What is run. At every point begins a polynomial for each input, or a sample of PD control with references
 * [points][2 angles, 2 rates]. */
typedef struct {
  int solver;
  double tolerance;
  double renewal, newton; /* RADAU5's: contraction above which the Jacobian is evaluated anew; share of the tolerance that
                             iterations may leave, 0 for its own choice */
  double pace;               /* usual ratio of rates to coordinates [1/s] */
  int n_points, n_orders;
  const double *times;
  const int *restarts, *recorded; /* [points] */
  const double *polynomials;      /* [points][orders][inputs], derivatives */
  const double *references;       /* NULL: there is no loop */
  double proportional[2], derivative[2];
} peer_task;

static struct {
  const peer_task *task;
  flex_plant *plant;
  int n, n_outputs, point, last; /* interval of the present polynomials; end of the present part */
  int next;                      /* point to be recorded next */
  const double *pieces;
  double u[MOST], mass[MOST * MOST], *records;
  long counts[2]; /* steps, evaluations */
} now;

/* ---- the equations ---- */

static void inputs_at(double t) {
  const peer_task *task = now.task;
  int m = now.plant->model->n_inputs;
  if (task->references) return;
  while (now.point + 1 < now.last && t > task->times[now.point + 1]) now.point++;
  while (now.point > 0 && t < task->times[now.point]) now.point--;
  const double *c = now.pieces + (size_t)now.point * (size_t)(task->n_orders * m), tau = t - task->times[now.point];
  for (int i = 0; i < m; i++) {
    double value = 0.0;
    for (int k = task->n_orders - 1; k >= 0; k--) value = value * tau + c[k * m + i];
    now.u[i] = value;
  }
}

static void residual(const double *y, const double *v, const double *a, double *r) {
  now.counts[1]++;
  flex_residual(&now.plant->equations, y, v, a, now.u, r);
}

/* a = -M^-1 b, with the factor of M left behind */
static void accelerate(const double *y, const double *v, double *a) {
  static const double zero[MOST];
  flex_mass_matrix(&now.plant->equations, y, now.u, now.mass);
  flex_cholesky_factor(now.n, now.mass);
  residual(y, v, zero, a);
  flex_cholesky_solve(now.n, now.mass, a);
  for (int i = 0; i < now.n; i++) a[i] = -a[i];
}

static void jacobian(const double *y, const double *v, const double *a, double *result) {
  flex_equations *e = &now.plant->equations;
  static double w[100000];
  const double *arg[] = {y, v, a, now.u, e->d, 0, 0, 0, 0};
  double *res[] = {result, 0, 0};
  peer_jacobian(arg, res, e->iw, w, 0);
}

/* dv'/d(y, v) [n x 2n] at a point without its acceleration */
static void explicit_jacobian(const double *y, const double *v, double *result) {
  double a[MOST];
  accelerate(y, v, a);
  jacobian(y, v, a, result);
  for (int j = 0; j < 2 * now.n; j++) flex_cholesky_solve(now.n, now.mass, result + j * now.n);
  for (int i = 0; i < 2 * now.n * now.n; i++) result[i] = -result[i];
}

static void record(const double *y, const double *v, const double *a) {
  flex_equations *e = &now.plant->equations;
  const double *const arguments[] = {y, v, a, now.u, e->d};
  flex_call(e, &now.plant->model->outputs, 5, arguments, now.records);
  now.records += now.n_outputs;
}

/* the next point to be recorded up to a time; -1 if there is none */
static int due(double time) {
  const peer_task *task = now.task;
  while (now.next <= now.last && !task->recorded[now.next]) now.next++;
  return now.next <= now.last && task->times[now.next] <= time ? now.next : -1;
}

/* ---- RADAU5 ---- */
#ifdef PEER_RADAU
void radau5_(int *n, void (*fcn)(int *, double *, double *, double *, double *, int *), double *x, double *y, double *xend,
             double *h, double *rtol, double *atol, int *itol,
             void (*jac)(int *, double *, double *, double *, int *, double *, int *), int *ijac, int *mljac, int *mujac,
             void (*mas)(int *, double *, int *, double *, int *), int *imas, int *mlmas, int *mumas,
             void (*solout)(int *, double *, double *, double *, double *, double *, int *, int *, double *, int *, int *),
             int *iout, double *work, int *lwork, int *iwork, int *liwork, double *rpar, int *ipar, int *idid);
double contr5_(int *i, double *x, double *cont, int *lrc);

static void radau_rate(int *size, double *t, double *z, double *f, double *rpar, int *ipar) {
  int n = now.n, is_index_1 = now.task->solver == INDEX_1_RADAU;
  (void)size, (void)rpar, (void)ipar;
  inputs_at(*t);
  memcpy(f, z + n, (size_t)(is_index_1 ? 2 * n : n) * sizeof *f);
  if (is_index_1)
    residual(z, z + n, z + 2 * n, f + 2 * n);
  else
    accelerate(z, z + n, f + n);
}

static void radau_jacobian(int *size, double *t, double *z, double *df, int *ld, double *rpar, int *ipar) {
  int n = now.n;
  (void)size, (void)ld, (void)rpar, (void)ipar;
  inputs_at(*t);
  if (now.task->solver == EXPLICIT_RADAU) {
    explicit_jacobian(z, z + n, df);
    return;
  }
  jacobian(z, z + n, z + 2 * n, df);
  flex_mass_matrix(&now.plant->equations, z, now.u, df + 2 * n * n);
}

static void radau_mass(int *size, double *mass, int *ld, double *rpar, int *ipar) {
  (void)rpar, (void)ipar;
  for (int i = 0; i < *size * *ld; i++) mass[i] = 0.0;
}

static void radau_output(int *count, double *before, double *t, double *z, double *cont, double *error, int *lrc, int *size,
                         double *rpar, int *ipar, int *stop) {
  double at[3 * MOST], a[MOST];
  int n = now.n, is_index_1 = now.task->solver == INDEX_1_RADAU;
  (void)before, (void)z, (void)error, (void)rpar, (void)ipar, (void)stop;
  if (*count == 1) return;
  now.counts[0]++;
  for (int point; (point = due(*t)) >= 0; now.next++) {
    double time = now.task->times[point];
    for (int i = 1; i <= *size; i++) at[i - 1] = contr5_(&i, &time, cont, lrc);
    inputs_at(time);
    if (!is_index_1) accelerate(at, at + n, a);
    record(at, at + n, is_index_1 ? at + 2 * n : a);
  }
}

static int radau(double begin, double end, double *state, double *step) {
  static double work[40000];
  static int iwork[1000];
  int n = now.n, is_index_1 = now.task->solver == INDEX_1_RADAU, size = (is_index_1 ? 3 : 2) * n, m1 = size - n;
  int one = 1, zero = 0, lwork = 40000, liwork = 1000, band = 0, result = 0, ipar = 0;
  double tolerance = now.task->tolerance, rtol[3 * MOST], atol[3 * MOST], rpar = 0.0, pace = now.task->pace;
  const double sizes[] = {LENGTH, LENGTH * pace, LENGTH * pace * pace};
  for (int i = 0; i < size; i++) rtol[i] = fmax(LENGTH * tolerance, 1e-14), atol[i] = sizes[i / n] * tolerance;
  memset(work, 0, 20 * sizeof *work);
  memset(iwork, 0, 20 * sizeof *iwork);
  work[2] = now.task->renewal;
  work[3] = now.task->newton > 0.0 ? now.task->newton : fmin(0.03, sqrt(0.1 * pow(tolerance, 2.0 / 3.0)));
  iwork[1] = 10000000;
  iwork[8] = m1;
  iwork[9] = n;
  if (is_index_1) accelerate(state, state + n, state + 2 * n);
  radau5_(&size, radau_rate, &begin, state, &end, step, rtol, atol, &one, radau_jacobian, &one, &n, &n, radau_mass,
          is_index_1 ? &one : &zero, &band, &band, radau_output, &one, work, &lwork, iwork, &liwork, &rpar, &ipar, &result);
  return result != 1;
}
#else
static int radau(double begin, double end, double *state, double *step) {
  return (void)begin, (void)end, (void)state, (void)step, 1;
}
#endif

/* ---- SUNDIALS ---- */
#ifdef PEER_SUNDIALS
#include <arkode/arkode_arkstep.h>
#include <ida/ida.h>
#include <nvector/nvector_serial.h>
#include <sunlinsol/sunlinsol_dense.h>
#include <sunmatrix/sunmatrix_dense.h>

static struct {
  SUNContext context;
  N_Vector z, rate, weights;
  SUNMatrix matrix;
  SUNLinearSolver solver;
  void *memory;
} sun;

static int ida_residual(realtype t, N_Vector z, N_Vector rate, N_Vector r, void *user) {
  const double *y = NV_DATA_S(z), *dy = NV_DATA_S(rate);
  double *f = NV_DATA_S(r);
  int n = now.n;
  (void)user;
  inputs_at(t);
  for (int i = 0; i < n; i++) f[i] = dy[i] - y[n + i];
  residual(y, y + n, dy + n, f + n);
  return 0;
}

static int ida_jacobian(realtype t, realtype c, N_Vector z, N_Vector rate, N_Vector r, SUNMatrix j, void *user, N_Vector t1,
                        N_Vector t2, N_Vector t3) {
  static double by_motion[2 * MOST * MOST];
  const double *y = NV_DATA_S(z), *dy = NV_DATA_S(rate);
  int n = now.n;
  (void)user, (void)r, (void)t1, (void)t2, (void)t3;
  inputs_at(t);
  jacobian(y, y + n, dy + n, by_motion);
  flex_mass_matrix(&now.plant->equations, y, now.u, now.mass);
  SUNMatZero(j);
  for (int k = 0; k < n; k++) {
    SM_ELEMENT_D(j, k, k) = c;
    SM_ELEMENT_D(j, k, n + k) = -1.0;
    for (int i = 0; i < n; i++) {
      SM_ELEMENT_D(j, n + i, k) = by_motion[k * n + i];
      SM_ELEMENT_D(j, n + i, n + k) = by_motion[(n + k) * n + i] + c * now.mass[k * n + i];
    }
  }
  return 0;
}

static int arkode_rate(realtype t, N_Vector z, N_Vector rate, void *user) {
  const double *y = NV_DATA_S(z);
  double *f = NV_DATA_S(rate);
  (void)user;
  inputs_at(t);
  memcpy(f, y + now.n, (size_t)now.n * sizeof *f);
  accelerate(y, y + now.n, f + now.n);
  return 0;
}

static int arkode_jacobian(realtype t, N_Vector z, N_Vector rate, SUNMatrix j, void *user, N_Vector t1, N_Vector t2, N_Vector t3) {
  static double rows[2 * MOST * MOST];
  const double *y = NV_DATA_S(z);
  int n = now.n;
  (void)rate, (void)user, (void)t1, (void)t2, (void)t3;
  inputs_at(t);
  explicit_jacobian(y, y + n, rows);
  SUNMatZero(j);
  for (int k = 0; k < n; k++) SM_ELEMENT_D(j, k, n + k) = 1.0;
  for (int k = 0; k < 2 * n; k++)
    for (int i = 0; i < n; i++) SM_ELEMENT_D(j, n + i, k) = rows[k * n + i];
  return 0;
}

static int sundials_create(const double *state) {
  int n = now.n, is_ida = now.task->solver == IDA, failed = SUNContext_Create(NULL, &sun.context);
  double tolerance = now.task->tolerance;
  sun.z = N_VNew_Serial(2 * n, sun.context);
  sun.rate = N_VNew_Serial(2 * n, sun.context);
  sun.weights = N_VNew_Serial(2 * n, sun.context);
  sun.matrix = SUNDenseMatrix(2 * n, 2 * n, sun.context);
  sun.solver = SUNLinSol_Dense(sun.z, sun.matrix, sun.context);
  memcpy(NV_DATA_S(sun.z), state, (size_t)(2 * n) * sizeof *state);
  for (int i = 0; i < 2 * n; i++) NV_Ith_S(sun.weights, i) = tolerance * LENGTH * (i < n ? 1.0 : now.task->pace);
  if (is_ida) {
    sun.memory = IDACreate(sun.context);
    failed |= IDAInit(sun.memory, ida_residual, now.task->times[0], sun.z, sun.rate);
    failed |= IDASVtolerances(sun.memory, LENGTH * tolerance, sun.weights);
    failed |= IDASetLinearSolver(sun.memory, sun.solver, sun.matrix) | IDASetJacFn(sun.memory, ida_jacobian);
    return failed | IDASetMaxNumSteps(sun.memory, 10000000);
  }
  sun.memory = ARKStepCreate(NULL, arkode_rate, now.task->times[0], sun.z, sun.context);
  failed |= ARKStepSVtolerances(sun.memory, LENGTH * tolerance, sun.weights) | ARKStepSetOrder(sun.memory, 5);
  failed |= ARKStepSetLinearSolver(sun.memory, sun.solver, sun.matrix) | ARKStepSetJacFn(sun.memory, arkode_jacobian);
  failed |= ARKStepSetInterpolantType(sun.memory, ARK_INTERP_LAGRANGE);
  return failed | ARKStepSetMaxNumSteps(sun.memory, 10000000);
}

static void sundials_free(void) {
  long count = 0;
  now.task->solver == IDA ? IDAGetNumSteps(sun.memory, &count) : ARKStepGetNumSteps(sun.memory, &count);
  now.counts[0] += count;
  now.task->solver == IDA ? IDAFree(&sun.memory) : ARKStepFree(&sun.memory);
  N_VDestroy(sun.z), N_VDestroy(sun.rate), N_VDestroy(sun.weights);
  SUNLinSolFree(sun.solver), SUNMatDestroy(sun.matrix), SUNContext_Free(&sun.context);
}

static int sundials(double begin, double end, double *state) {
  int n = now.n, is_ida = now.task->solver == IDA, failed = 0;
  double *z = NV_DATA_S(sun.z), *rate = NV_DATA_S(sun.rate), a[MOST], reached = begin;
  memcpy(z, state, (size_t)(2 * n) * sizeof *z);
  inputs_at(begin);
  memcpy(rate, state + n, (size_t)n * sizeof *z);
  accelerate(state, state + n, rate + n);
  failed |= is_ida ? IDAReInit(sun.memory, begin, sun.z, sun.rate) : ARKStepReset(sun.memory, begin, sun.z);
  failed |= is_ida ? IDASetStopTime(sun.memory, end) : ARKStepSetStopTime(sun.memory, end);
  while (!failed && reached < end) {
    int point = due(end);
    double time = point < 0 ? end : now.task->times[point];
    int flag = is_ida ? IDASolve(sun.memory, time, &reached, sun.z, sun.rate, IDA_NORMAL)
                      : ARKStepEvolve(sun.memory, time, sun.z, &reached, ARK_NORMAL);
    failed = flag < 0;
    if (failed || point < 0) continue;
    inputs_at(time);
    if (!is_ida) accelerate(z, z + n, a);
    record(z, z + n, is_ida ? rate + n : a);
    now.next++;
  }
  memcpy(state, z, (size_t)(2 * n) * sizeof *z);
  return failed;
}
#else
static int sundials_create(const double *state) { return (void)state, 1; }
static void sundials_free(void) {}
static int sundials(double begin, double end, double *state) { return (void)begin, (void)end, (void)state, 1; }
#endif

/* ---- a run ---- */

/* torques of PD control at the present sample */
static void sample(int point, const double *state) {
  const peer_task *task = now.task;
  const double *reference = task->references + 4 * point;
  for (int j = 0; j < 2; j++)
    now.u[j] = task->proportional[j] * (reference[j] - state[j]) + task->derivative[j] * (reference[2 + j] - state[now.n + j]);
}

/* all parts of a motion, from the static equilibrium; 0 if it came to its end */
static int run(const double *start, double *records) {
  const peer_task *task = now.task;
  double state[3 * MOST], a[MOST], step = 0.0;
  int n = now.n, failed = 0, is_radau = task->solver <= INDEX_1_RADAU;
  memcpy(state, start, (size_t)(2 * n) * sizeof *state);
  now.records = records, now.point = 0, now.next = 1;
  now.counts[0] = now.counts[1] = 0;
  if (!is_radau && sundials_create(state)) return 1;
  for (int first = 0, last; !failed && first < task->n_points - 1; first = last) {
    for (last = first + 1; last < task->n_points - 1 && !task->restarts[last];) last++;
    double begin = task->times[first], end = task->times[last];
    now.point = first, now.last = last;
    if (task->references) sample(first, state);
    inputs_at(begin);
    if (first == 0) {
      accelerate(state, state + n, a);
      record(state, state + n, a);
    }
    step = task->references ? end - begin : 1e-4;
    failed = is_radau ? radau(begin, end, state, &step) : sundials(begin, end, state);
  }
  if (!is_radau) sundials_free();
  return failed;
}

/* records [recorded points, the first included][outputs]; figures: processor time of the fastest of so many runs [s], steps,
 * evaluations; -1: it failed */
EXPORTED int peer_run(const peer_task *task, int repeat, double *records, double *figures) {
  static double memory[2000000], pieces[2000000], start[2 * MOST];
  const flex_model *model = &flex_the_model;
  int n = model->n, m = model->n_inputs;
  size_t block = (size_t)(task->n_orders * m), count = task->references ? 0 : (size_t)task->n_points * block;
  if (n > MOST || flex_plant_size(model) > sizeof memory || count * sizeof *pieces > sizeof pieces) return -1;

  /* start values and derived parameters */
  memset(memory, 0, sizeof memory);
  flex_plant *plant = flex_plant_create(model, memory);
  if (task->polynomials)
    for (int i = 0; i < m; i++) flex_inputs_set(&plant->inputs, i, task->times[0], task->polynomials[i]);
  flex_plant_inputs_changed(plant);
  if (flex_plant_begin(plant).outcome != FLEX_DONE) return -1;
  memcpy(start, plant->integrator.y, (size_t)n * sizeof *start);
  memcpy(start + n, plant->integrator.v, (size_t)n * sizeof *start);
  memset(now.u, 0, sizeof now.u);
  for (size_t i = 0; i < count; i++) pieces[i] = task->polynomials[i] / flex_factorial((int)(i % block) / m);
  now.task = task, now.plant = plant, now.n = n, now.n_outputs = model->n_outputs, now.pieces = pieces;

  figures[0] = HUGE_VAL;
  for (int k = 0; k < repeat; k++) {
    clock_t began = clock();
    if (run(start, records)) return -1;
    figures[0] = fmin(figures[0], (double)(clock() - began) / CLOCKS_PER_SEC);
  }
  figures[1] = (double)now.counts[0], figures[2] = (double)now.counts[1];
  return 0;
}

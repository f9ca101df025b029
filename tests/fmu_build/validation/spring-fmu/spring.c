/* A mass on a spring that an input pulls: a sound FMU 2.0 for both interfaces, written apart from the package's runtime.
   The name in resources/mutant.txt spoils it in one respect, so that validation has something to find. */
#define _GNU_SOURCE
#pragma GCC diagnostic ignored "-Wunused-parameter" // the standard's functions have what others need
#include "fmi2Functions.h"

#include <fenv.h>
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define GUID "{spring}"
#define LARGEST_STEP 1e-3
#define BUFFER 64

#define MUTANTS(X)                                                                                                        \
  X(sound) X(version) X(types) X(exit_at_start) X(no_instance) X(any_guid) X(uri_slashes) X(uri_percent) X(nan) X(nan_late)         \
  X(output_jumps) X(never_freed) X(malloc_leak) X(overrun) X(reset_nothing) X(reset_parameter) X(reset_velocity) X(state_half)      \
  X(saving_disturbs) X(state_leaks_input) X(addresses) X(shared_state) X(shared_parameter) X(static_count) X(own_step)              \
  X(part_of_step) X(loses_time) X(first_step) X(held_inputs) X(negative_derivatives) X(nan_derivatives) X(some_derivatives)         \
  X(directional) X(directional_input) X(history) X(rate) X(state_order) X(nominals) X(cs_other) X(cs_pull) X(undeclared_input)      \
  X(undeclared_state) X(not_linear) X(undeclared_initial) X(start) X(start_string) X(parameter_ignored) X(parameter_clamped)        \
  X(any_reference) X(any_order) X(array_end) X(crash) X(crash_late) X(hang) X(prints) X(directory) X(environment) X(rounding)       \
  X(handler) X(leaves_file) X(open_file) X(time_stands) X(not_boolean) X(out_of_range) X(terminate_fails) X(second_fails)           \
  X(discards) X(uninitialised) X(ends_early) X(once) X(counts) X(pending) X(asynchronous) X(derivatives_ignored) X(derivatives_doubled) \
  X(derivatives_negated) X(nan_first) X(no_indicators) X(nan_indicator) X(state_keeps_input) X(state_keeps_time) X(set_backwards)   \
  X(get_backwards) X(reading_disturbs) X(undeclared_late) X(seed_ignored) X(serialises_beyond) X(state_not_null)                    \
  X(state_anew) X(integrator_step) X(time_half) X(single_precision) X(writes_resource) X(warns) X(closes_output)                    \
  X(reused_state) X(boolean_42) X(offset) X(offset_derivative) X(step_short) X(start_ignored) X(stop_ignored) X(initial_ignored)      \
  X(state_leak) X(state_leak_callback) X(tunable_refused) X(constant_indicator) X(second_ignored) X(last_time) X(pending_forever)   \
  X(pending_text) X(log_category) X(log_refused) X(ticks) X(event_past) X(traps) X(handler_replaced) X(forks) X(threads) X(crash_wanders)

#define ENUM(name) M_##name,
#define TEXT(name) #name,
enum { MUTANTS(ENUM) COUNT };
static const char *const names[] = {MUTANTS(TEXT)};

enum { PULL, POSITION, VELOCITY, POSITION_RATE, VELOCITY_RATE, FORCE, STIFFNESS, DAMPING, FREQUENCY, TIME, VARIABLES };
enum { STARTED = 1, INITIALIZING = 2, RUNNING = 4, ENDED = 8 };

typedef struct {
  double time, x[2], u, u_rate, u_bend, stiffness, damping, stop;
  int material, locked, steps, modes;
  char label[BUFFER];
} State;

typedef struct {
  State now;
  fmi2CallbackFunctions callbacks;
  char *scratch;
  int mutant, is_slave, discarded, waits;
} Spring;

static State shared;
static double shared_stiffness = 40.0;
static int instances, made, calls, last_mutant;

static State *now(Spring *s) { return s->mutant == M_shared_state ? &shared : &s->now; }
static int is(const Spring *s, int mutant) { return s->mutant == mutant; }

static void rates(Spring *s, const double *x, double u, double *dx) {
  double k = is(s, M_shared_parameter) ? shared_stiffness : now(s)->stiffness;
  dx[0] = x[1];
  dx[1] = k * (u - x[0]) - now(s)->damping * x[1];
  if (is(s, M_rate) && !s->is_slave) dx[1] *= 1.3;
  if (is(s, M_cs_other) && s->is_slave) dx[1] *= 1.05;
  if (is(s, M_cs_pull) && s->is_slave) dx[1] += 0.3 * k * u;
  if (is(s, M_parameter_ignored)) dx[1] = 40.0 * (u - x[0]) - 0.5 * x[1];
}

/* one step of the classical Runge-Kutta method */
static void runge_kutta(Spring *spring, double h) {
  State *s = now(spring);
  double k[4][2], y[2];
  static const double at[4] = {0.0, 0.5, 0.5, 1.0};
  for (int stage = 0; stage < 4; stage++) {
    for (int i = 0; i < 2; i++) y[i] = s->x[i] + (stage ? at[stage] * h * k[stage - 1][i] : 0.0);
    rates(spring, y, s->u + at[stage] * h * (s->u_rate + 0.5 * at[stage] * h * s->u_bend), k[stage]);
  }
  for (int i = 0; i < 2; i++) s->x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
  s->u += h * (s->u_rate + 0.5 * h * s->u_bend);
  s->u_rate += h * s->u_bend;
}

static void start(Spring *spring) {
  State *s = now(spring), fresh = {0.0, {0.1, 0.0}, 0.0, 0.0, 0.0, 40.0, 0.5, INFINITY, 1, 0, 0, STARTED, "spring"};
  if (is(spring, M_uninitialised)) fresh.x[1] = s->x[1] * 0.0 + 1e-3 * (calls++ % 7);
  *s = fresh;
  if (is(spring, M_start)) s->x[0] = 0.11;
  if (is(spring, M_start_string)) strcpy(s->label, "string");
  shared_stiffness = 40.0;
}

static char resource[4096];

static int mutant_in(const char *uri) {
  char path[4096], name[BUFFER] = "sound";
  size_t n = 0;
  uri += strncmp(uri, "file:", 5) ? 0 : 5;
  if (!strncmp(uri, "//localhost/", 12)) uri += 11;
  else if (!strncmp(uri, "//", 2)) uri += 2;
  for (; *uri && n < sizeof path - 16; uri++) {
    unsigned code;
    if (*uri == '%' && sscanf(uri + 1, "%2x", &code) == 1) path[n++] = (char)code, uri += 2;
    else path[n++] = *uri;
  }
  strcpy(path + n, "/mutant.txt");
  FILE *file = fopen(path, "r");
  if (file) {
    strcpy(resource, path);
    if (fscanf(file, "%63s", name) != 1) strcpy(name, "sound");
    fclose(file);
  }
  for (int i = 0; i < COUNT; i++)
    if (!strcmp(names[i], name)) return i;
  return M_sound;
}

static void on_signal(int number) {}
static int sleeping(void *nothing) { return sleep(600), 0; }

static void disturb(Spring *s) {
  if (is(s, M_prints)) printf("one step\n");
  if (is(s, M_directory) && chdir("/")) abort();
  if (is(s, M_environment)) setenv("LC_ALL", "C", 1);
  if (is(s, M_rounding)) fesetround(FE_UPWARD);
  if (is(s, M_handler)) signal(SIGFPE, on_signal);
  if (is(s, M_handler_replaced)) signal(SIGINT, on_signal);
  if (is(s, M_traps)) feenableexcept(FE_DIVBYZERO);
  if (is(s, M_forks) && !fork()) sleep(600), _exit(0);
  static char stack[1 << 16]; /* pthread_create would need a new glibc */
  int flags = CLONE_VM | CLONE_FS | CLONE_FILES | CLONE_SIGHAND | CLONE_THREAD | CLONE_SYSVSEM;
  if (is(s, M_threads) && !calls++ && clone(sleeping, stack + sizeof stack, flags, NULL) < 0) abort();
  if (is(s, M_open_file) && !fopen("/dev/null", "r")) abort();
  if (is(s, M_closes_output)) close(STDOUT_FILENO);
  if (is(s, M_leaves_file)) {
    FILE *file = fopen("log.txt", "w");
    if (file) fclose(file);
  }
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String uri,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  int mutant = last_mutant = mutant_in(uri);
  if (mutant == M_exit_at_start) exit(0);
  if (mutant == M_no_instance) return NULL;
  if (mutant != M_any_guid && strcmp(guid, GUID)) return NULL;
  if (mutant == M_uri_slashes && strncmp(uri, "file:///", 8)) return NULL;
  if (mutant == M_uri_percent && strchr(uri, '%')) return NULL;
  if (mutant == M_second_fails && instances) return NULL;
  if (mutant == M_once && calls++) return NULL;
  if (mutant == M_counts && calls++ >= 50) {
    callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, "logStatusError", "the licence was not found");
    return NULL;
  }
  Spring *s = callbacks->allocateMemory(1, sizeof *s);
  if (!s) return NULL;
  instances++, made++;
  s->callbacks = *callbacks;
  s->scratch = callbacks->allocateMemory(1, 16);
  s->mutant = mutant;
  s->is_slave = type == fmi2CoSimulation;
  start(s);
  if (mutant == M_writes_resource) {
    FILE *file = fopen(strcat(resource, ".log"), "w");
    if (file) fclose(file);
  }
  return s;
}

void fmi2FreeInstance(fmi2Component c) {
  Spring *s = c;
  if (!s) return;
  instances--;
  if (is(s, M_malloc_leak) && !malloc(1000)) abort();
  if (!is(s, M_never_freed)) s->callbacks.freeMemory(s->scratch);
  s->callbacks.freeMemory(s);
}

static fmi2Status refuse(Spring *s, const char *what) {
  s->callbacks.logger(s->callbacks.componentEnvironment, "spring", fmi2Error, is(s, M_log_category) ? "mine" : "logStatusError", what);
  return fmi2Error;
}

/* whether a call is legal in the modes given */
static int legal(Spring *s, int modes) { return is(s, M_any_order) || (now(s)->modes & modes); }

fmi2Status fmi2Reset(fmi2Component c) {
  Spring *s = c;
  State old = *now(s);
  if (is(s, M_reset_nothing)) {
    now(s)->modes = STARTED;
    return fmi2OK;
  }
  start(s);
  if (is(s, M_reset_parameter)) now(s)->stiffness = old.stiffness;
  if (is(s, M_reset_velocity)) now(s)->x[1] = old.x[1];
  return fmi2OK;
}

static double value_of(Spring *spring, unsigned which) {
  State *s = now(spring);
  double dx[2];
  rates(spring, s->x, s->u, dx);
  switch (which) {
    case PULL: return s->u;
    case POSITION:
      if (is(spring, M_static_count)) return s->x[0] + 1e-6 * calls++;
      if (is(spring, M_undeclared_input)) return s->x[0] + 0.1 * s->u;
      if (is(spring, M_undeclared_late) && s->time > 0.4) return s->x[0] + 0.1 * s->u;
      if (is(spring, M_output_jumps) && s->time > 0.5) return INFINITY;
      if (is(spring, M_out_of_range)) return s->x[0] * 500.0;
      return s->x[0];
    case VELOCITY: return s->x[1];
    case POSITION_RATE: return dx[0];
    case VELOCITY_RATE: return is(spring, M_not_linear) ? dx[1] + s->x[0] * s->x[0] : dx[1];
    case STIFFNESS: return is(spring, M_parameter_clamped) ? 40.0 : s->stiffness;
    case DAMPING: return s->damping;
    case FREQUENCY: return sqrt(s->stiffness) + (is(spring, M_undeclared_initial) ? s->damping : 0.0);
    case TIME: return is(spring, M_time_stands) ? 0.0 : s->time;
    default:
      if (is(spring, M_nan)) return NAN;
      if (is(spring, M_nan_late) && s->time > 0.6) return NAN;
      if (is(spring, M_undeclared_state)) return s->stiffness * (s->u - s->x[0]) + 0.3 * s->x[1];
      return s->stiffness * (s->u - s->x[0]) + (is(spring, M_offset) || is(spring, M_offset_derivative) ? 1e6 : 0.0);
  }
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real value[]) {
  Spring *s = c;
  for (size_t i = 0; i < n; i++) {
    if (r[i] >= VARIABLES && !is(s, M_any_reference)) return refuse(s, "no such variable");
    unsigned which = is(s, M_get_backwards) && n > 2 ? r[n - 1 - i] : r[i];
    value[i] = which < VARIABLES ? value_of(s, which) : 0.0;
    if (is(s, M_reading_disturbs) && r[i] == POSITION) now(s)->x[1] += 1e-7;
  }
  if (is(s, M_array_end) && n) value[n] = 0.0;
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real value[]) {
  Spring *spring = c;
  State *s = now(spring);
  for (size_t i = 0; i < n; i++) {
    if (r[i] >= VARIABLES && is(spring, M_any_reference)) continue;
    double v = value[is(spring, M_set_backwards) ? n - 1 - i : i];
    if (is(spring, M_single_precision)) v = (float)v;
    if (is(spring, M_initial_ignored) && s->modes == INITIALIZING && r[i] == STIFFNESS) continue;
    if (r[i] == PULL) s->u = v, s->u_rate = s->u_bend = 0.0;
    else if (r[i] == POSITION || r[i] == VELOCITY) s->x[r[i] - POSITION] = v;
    else if (r[i] == DAMPING && !(is(spring, M_tunable_refused) && s->modes == RUNNING)) s->damping = v;
    else if (r[i] == STIFFNESS && legal(spring, STARTED | INITIALIZING)) s->stiffness = shared_stiffness = v;
    else return refuse(spring, "this can't be set now");
  }
  return fmi2OK;
}

#define GETTER(kind, last, result)                                                                                          \
  fmi2Status fmi2Get##kind(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2##kind value[]) {                   \
    for (size_t i = 0; i < n; i++) {                                                                                        \
      if (r[i] > last && !is(c, M_any_reference)) return refuse(c, "no such variable");                                     \
      value[i] = result;                                                                                                    \
    }                                                                                                                       \
    return fmi2OK;                                                                                                          \
  }
#define SETTER(kind, fits, change)                                                                                          \
  fmi2Status fmi2Set##kind(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2##kind value[]) {             \
    for (size_t i = 0; i < n; i++) {                                                                                        \
      if (r[i] > 0 || !legal(c, STARTED | INITIALIZING) || !(fits)) return refuse(c, "this can't be set now");              \
      change;                                                                                                               \
    }                                                                                                                       \
    return fmi2OK;                                                                                                          \
  }

static int truth(Spring *s, unsigned which) {
  return which == 1 ? (now(s)->x[0] > 0.0) * (is(s, M_not_boolean) ? 7 : 1) : now(s)->locked * (is(s, M_boolean_42) ? 42 : 1);
}

GETTER(Integer, 0, now(c)->material)
SETTER(Integer, 1, now(c)->material = value[i])
GETTER(Boolean, 1, truth(c, r[i]))
SETTER(Boolean, 1, now(c)->locked = value[i])
GETTER(String, 0, now(c)->label)
SETTER(String, strlen(value[i]) < BUFFER, strcpy(now(c)->label, value[i]))

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
  if (*state && is(c, M_reused_state)) return fmi2OK;
  Spring *spring = c;
  if (!*state && is(c, M_state_leak_callback)) *state = spring->callbacks.allocateMemory(1, sizeof(State));
  if (!*state || is(c, M_state_anew)) *state = malloc(sizeof(State));
  memcpy(*state, now(c), sizeof(State));
  if (is(c, M_saving_disturbs)) now(c)->u_rate = 0.1;
  return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  State *s = now(c), old = *s;
  memcpy(s, state, sizeof *s);
  if (is(c, M_state_half)) s->x[1] = old.x[1];
  if (is(c, M_state_keeps_input)) s->u = old.u;
  if (is(c, M_state_keeps_time)) s->time = old.time;
  if (is(c, M_state_leaks_input)) s->damping = old.damping * (1.0 + 1e-6);
  return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  if (!is(c, M_state_leak) && !is(c, M_state_leak_callback)) free(*state);
  if (!is(c, M_state_not_null)) *state = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  *size = sizeof(State);
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  if (is(c, M_addresses)) { /* an address means nothing in another process, but a copy of it lives on here */
    State *copy = malloc(sizeof *copy);
    memcpy(copy, state, sizeof *copy);
    memset(bytes, 0, size);
    memcpy(bytes, &copy, sizeof copy);
  } else memcpy(bytes, state, size);
  if (is(c, M_serialises_beyond)) memset(bytes + size, 0x55, 8);
  return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  State *copy;
  if (!*state) *state = malloc(sizeof(State));
  memcpy(&copy, bytes, sizeof copy);
  if (is(c, M_addresses)) memcpy(*state, copy, sizeof *copy);
  else memcpy(*state, bytes, size);
  return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                        const fmi2ValueReference known[], size_t m, const fmi2Real dknown[],
                                        fmi2Real dunknown[]) {
  Spring *s = c;
  double u = 0.0, x[2] = {0.0, 0.0}, dx[2], k = now(s)->stiffness;
  for (size_t i = 0; i < m; i++) {
    double seed = is(s, M_seed_ignored) ? dknown[i] != 0.0 : dknown[i];
    if (known[i] > VELOCITY) return refuse(c, "no known");
    if (known[i] == PULL) u += seed * (is(s, M_directional_input) ? -1.0 : 1.0);
    else x[known[i] - POSITION] += seed;
  }
  rates(s, x, u, dx);
  for (size_t i = 0; i < n; i++) {
    double change[] = {u, x[0], x[1], dx[0], dx[1], k * (u - x[0])};
    if (unknown[i] > FORCE) return refuse(c, "no unknown");
    dunknown[i] = change[unknown[i]] * (is(s, M_directional) ? 1.01 : 1.0);
  }
  return fmi2OK;
}

/* co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean no_set_state) {
  Spring *spring = c;
  State *s = now(spring);
  if (!legal(spring, RUNNING) || (h <= 0.0 && !is(spring, M_any_order))) return refuse(spring, "no step now");
  if (time + h > s->stop + 1e-6 * h && !is(spring, M_stop_ignored)) return refuse(spring, "no step beyond the stop time");
  disturb(spring);
  double wanted = h;
  if (is(spring, M_own_step)) h = 0.01;
  if (is(spring, M_part_of_step)) h *= 0.97;
  if (is(spring, M_step_short) && h > 1e-3) h *= 0.99;
  if (is(spring, M_loses_time)) h -= 1e-3;
  if (is(spring, M_first_step) && s->steps == 0) h = 0.0;
  if (is(spring, M_crash) || (is(spring, M_crash_late) && time > 0.5)) abort();
  if (is(spring, M_crash_wanders) && made > 60) abort(); /* as where earlier instances have spoilt memory */
  while (is(spring, M_hang) && time > 0.1) usleep(1000); /* takes no processor time from others */
  if (is(spring, M_held_inputs)) s->u_rate = 0.0;
  if (is(spring, M_discards) && time > 0.3) return fmi2Discard;
  if (is(spring, M_ends_early) && time > 0.3) {
    spring->discarded = 1;
    return fmi2Discard;
  }
  if (is(spring, M_overrun)) spring->scratch[16 + s->steps % 4] = 1;
  int parts = 1 + (int)(fmax(h, 0.0) / LARGEST_STEP);
  for (int part = 0; part < parts && h > 0.0; part++) runge_kutta(spring, h / parts);
  s->steps++;
  s->time = (is(spring, M_start_ignored) ? s->time : time) + wanted * (is(spring, M_time_half) ? 0.5 : 1.0);
  int goes_on = is(spring, M_asynchronous) || is(spring, M_pending_text) || is(spring, M_pending_forever);
  if (is(spring, M_pending) || (goes_on && s->steps % 16 == 1)) return spring->waits = 2, fmi2Pending;
  return is(spring, M_warns) ? fmi2Warning : fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer order[],
                                       const fmi2Real value[]) {
  for (size_t i = 0; i < n; i++) {
    if (r[i] != PULL || order[i] < 1 || order[i] > 2) return refuse(c, "no such derivative");
    if (order[i] == 2) {
      now(c)->u_bend = value[i] * !is(c, M_second_ignored);
      continue;
    }
    now(c)->u_rate = value[i] * !is(c, M_derivatives_ignored);
    if (is(c, M_derivatives_doubled)) now(c)->u_rate *= 2.0;
    if (is(c, M_derivatives_negated)) now(c)->u_rate *= -1.0;
  }
  return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
  State *s = now(c);
  for (size_t i = 0; i < n; i++) {
    if (order[i] != 1) return refuse(c, "no such derivative");
    value[i] = r[i] == POSITION ? s->x[1] : s->stiffness * (s->u_rate - s->x[1]);
    if (is(c, M_negative_derivatives)) value[i] = -value[i];
    if (is(c, M_nan_derivatives) || (is(c, M_nan_first) && !s->steps)) value[i] = NAN;
    if (is(c, M_offset_derivative) && r[i] != POSITION) value[i] = 0.0;
    if (is(c, M_some_derivatives) && r[i] != POSITION) value[i] *= 1.04;
  }
  return fmi2OK;
}

/* model exchange */

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
  now(c)->time = time;
  return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  memcpy(now(c)->x, x, n * sizeof *x);
  return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  for (size_t i = 0; i < n; i++) x[i] = now(c)->x[is(c, M_state_order) ? 1 - i : i];
  return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
  Spring *s = c;
  rates(s, now(s)->x, now(s)->u, dx);
  if (is(s, M_not_linear)) dx[1] += now(s)->x[0] * now(s)->x[0];
  if (is(s, M_history)) dx[1] += 1e-9 * now(s)->steps++;
  return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  for (size_t i = 0; i < n; i++) x[i] = is(c, M_nominals) ? 0.0 : 1.0;
  return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  if (!legal(c, RUNNING)) return refuse(c, "no events now");
  memset(info, 0, sizeof *info);
  info->nextEventTimeDefined = is(c, M_ticks) || is(c, M_event_past);
  info->nextEventTime = is(c, M_ticks) ? 0.1 * (floor(now(c)->time / 0.1 + 1e-6) + 1.0) : now(c)->time - 0.01;
  return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *event, fmi2Boolean *end) {
  disturb(c);
  if (is(c, M_integrator_step)) now(c)->x[1] *= 0.99;
  *event = *end = fmi2False;
  return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
  if (is(c, M_no_indicators)) return refuse(c, "no event indicators");
  for (size_t i = 0; i < n; i++) z[i] = is(c, M_nan_indicator) ? NAN : is(c, M_constant_indicator) ? 1.0 : now(c)->x[0];
  return fmi2OK;
}

/* modes */

static fmi2Status go(Spring *s, int from, int to) {
  if (!legal(s, from)) return refuse(s, "not in this mode");
  now(s)->modes = to;
  return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real from,
                               fmi2Boolean ends, fmi2Real to) {
  if (!legal(c, STARTED)) return refuse(c, "not in this mode");
  now(c)->time = is(c, M_start_ignored) ? 0.0 : from;
  now(c)->stop = ends ? to : INFINITY;
  return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return go(c, STARTED, INITIALIZING); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return go(c, INITIALIZING, RUNNING); }
fmi2Status fmi2EnterEventMode(fmi2Component c) { return go(c, RUNNING, RUNNING); }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return go(c, RUNNING, RUNNING); }
fmi2Status fmi2Terminate(fmi2Component c) { return is(c, M_terminate_fails) ? fmi2Error : go(c, RUNNING, ENDED); }

/* what has nothing to do here */

const char *fmi2GetVersion(void) { return last_mutant == M_version ? "1.0" : fmi2Version; }
const char *fmi2GetTypesPlatform(void) { return last_mutant == M_types ? "other" : fmi2TypesPlatform; }

#define NOTHING(name, arguments, status) \
  fmi2Status name arguments { return status; }
#define STATUS(name, type) NOTHING(fmi2Get##name, (fmi2Component c, const fmi2StatusKind k, type *v), fmi2Discard)

NOTHING(fmi2CancelStep, (fmi2Component c), fmi2OK)
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
  Spring *s = c;
  if (kind != fmi2DoStepStatus) return fmi2Discard;
  *value = is(s, M_pending_forever) || (!is(s, M_pending) && s->waits-- > 0) ? fmi2Pending : fmi2OK;
  return fmi2OK;
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  *value = now(c)->time - (is(c, M_last_time) ? 0.005 : 0.0);
  return fmi2OK;
}
STATUS(IntegerStatus, fmi2Integer)
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
  *value = is(c, M_pending_text) ? NULL : "the step goes on";
  return kind == fmi2PendingStatus ? fmi2OK : fmi2Discard;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
  *value = kind == fmi2Terminated && ((Spring *)c)->discarded;
  return fmi2OK;
}
NOTHING(fmi2SetDebugLogging, (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]),
        is(c, M_log_refused) && n ? fmi2Error : fmi2OK)

#ifdef VISIBLE
void helper_of_mine(void);
void helper_of_mine(void) {}
#endif

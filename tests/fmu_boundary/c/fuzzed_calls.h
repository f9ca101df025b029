/* Calls of an FMU with arguments from a tape, each judged by what the standard and the FMU promise.
 *
 * The build defines what is fuzzed: GUID, N_INPUTS, N_SETTABLE, N_REALS, N_INTEGERS, and N_STATES and N_INDICATORS if there is
 * model exchange. */
#ifndef FLEXFMU_TEST_FUZZED_CALLS_H
#define FLEXFMU_TEST_FUZZED_CALLS_H

#include "importer.h"
#include "tape.h"

enum { N_SLOTS = 3 };

/* where an instance must be after the calls so far */
typedef struct {
  flex_phase phase;
  double time;
} expectation;

typedef struct {
  fmi2Component component;
  importer *ear;
  fmi2Type type;
  expectation now;
  int shown[N_LOG_CATEGORIES];
  int before[N_LOG_CATEGORIES]; /* messages heard before the present call */
  uint64_t trace; /* hash of all that the calls have returned */
  fmi2FMUstate slots[N_SLOTS];
  expectation saved[N_SLOTS];
} fuzzed;

/* a new instance in the state "instantiated" */
void fuzzed_begin(fuzzed *one, importer *ear, fmi2Type type, fmi2Boolean logging);

/* one call that the tape chooses; where `is_numeric`, only calls that depend on nothing but the FMU state */
void fuzzed_call(fuzzed *one, tape *tape, int is_numeric);

/* number of calls so far */
extern unsigned long fuzzed_count;

/* frees saved states and the instance, in whatever state it is */
void fuzzed_end(fuzzed *one);

/* checks the status of a call against the state, what is logged and what the function may return */
void fuzzed_judge(fuzzed *one, flex_call_id call, fmi2Status status);

/* adds to the trace */
void fuzzed_note(fuzzed *one, const void *bytes, size_t size);

#endif

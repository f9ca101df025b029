/* The master's loop over communication points as a list of instructions on fixed buffers.
 *
 * A run is prepared in Python: which slave is stepped, set and read in which order, and where the numbers are. Here the
 * instructions are carried out, point after point, with the same calls and in the same order. */
#ifndef FLEXFMU_MASTER_H
#define FLEXFMU_MASTER_H

#include <stddef.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

/* what an instruction does, and which of its fields it needs; `component` is where the handle of an FMU's instance is */
enum {
  MASTER_VALUES,      /* fmi2SetReal or fmi2GetReal: function, component, references, count, target */
  MASTER_DERIVATIVES, /* fmi2SetRealInputDerivatives or fmi2GetRealOutputDerivatives: the same and orders */
  MASTER_STEP,        /* fmi2DoStep: function, component */
  MASTER_COPY,        /* target[0 .. count - 1] = source[..] */
  MASTER_GATHER,      /* target[places[i]] = source[columns[i]], i < count */
  MASTER_FINITE,      /* fails unless target[0 .. count - 1] are finite */
  MASTER_EVALUATE,    /* the equations of a block: function(what component points to), unless count > 0 and the inputs
                         source[0 .. count - 1] are those seen last, target[..] */
  MASTER_SAMPLE,      /* fmi2DoStep to a sample instant: function, component, target = {time reached, step or 0} */
  MASTER_TASK,        /* fmi2DoStep from a sample instant: function, component, target = {first, sample time, count} */
  MASTER_REFRESH,     /* fmi2SetReal with target[i] = source[columns[i]], i < count, unless they are equal already */
  MASTER_MULTIPLY,    /* target[places[i]] *= source[i], i < count */
  MASTER_ADD,         /* target[places[i]] += source[i], i < count */
  MASTER_CALL         /* a Python callback: function(point, begin, end), begin = end in an exchange */
};

/* when an instruction is carried out */
enum {
  MASTER_ALWAYS,
  MASTER_AT_JUMPS, /* where signals may jump */
  MASTER_WHEN_DUE  /* where due[point] is set */
};

typedef struct {
  int kind, condition, owner; /* owner: index of the slave that is called */
  size_t count, stride;
  void (*function)(void);
  void *const *component;
  const unsigned *references;
  const int *orders;
  const long long *columns, *places;
  const double *source; /* of a table: its first row, `stride` between the rows, of which `point` is read */
  double *target;
  const unsigned char *due;
} master_instruction;

/* signals that are recorded: `count` doubles, each copied into the next place of its column */
typedef struct {
  const double *signals;
  double *columns;
  size_t count;
} master_channel;

/* what happens from one communication point to the next: `advance` over the step, then `exchange` at its end; recorded is
 * after the exchange, where signals may jump also before it */
typedef struct {
  const master_instruction *advance, *exchange;
  size_t n_advance, n_exchange;
  const master_channel *channels;
  size_t n_channels;
  size_t capacity; /* length of each column */
  const double *times;
  const unsigned char *jumps, *instants; /* whether signals may jump at a point, and whether they are recorded there */
  double *recorded_times;
  volatile int *active; /* the owner of the instruction that is, or was last, carried out; another process may look at it */
} master_program;

/* how far a run has come */
typedef struct {
  size_t points;  /* steps that all slaves have completed */
  size_t records; /* instants in the recording */
  size_t instruction; /* which instruction failed, exchanges counted after the steps */
  int status;       /* fmi2Status of the failure, 0 of others */
} master_progress;

/* goes on until `points` steps are completed; 0, or 1 where an instruction has failed */
EXPORTED int master_run(const master_program *program, size_t points, master_progress *progress);

#endif

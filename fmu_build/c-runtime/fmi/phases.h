/* States of an instance, and sets of them; the tables of fmi2_states.h and fmi3_states.h say which function may be called in which.
 * A step that fails leads to a state of its own in FMI 2.0 alone: STEPPING_PHASE is what each version has. */
#ifndef FLEXFMU_PHASES_H
#define FLEXFMU_PHASES_H

typedef enum {
  INSTANTIATED = 1 << 0,
  INITIALISATION_MODE = 1 << 1,
  STEP_COMPLETE = 1 << 2,
  STEP_MODE = STEP_COMPLETE, /* its name in FMI 3.0 */
  EVENT_MODE = 1 << 3,
  CONTINUOUS_TIME_MODE = 1 << 4,
  TERMINATED = 1 << 5,
  STEP_FAILED = 1 << 6,
  /* FMI 3.0: within a step, while the importer sets inputs, or reads */
  INPUT_UPDATE = 1 << 7,
  OUTPUT_UPDATE = 1 << 8
} flex_phase;

/* which instances have a function: those for co-simulation, those for model exchange, or both */
typedef enum { STEPPING = 1 << 0, EXCHANGE = 1 << 1, BOTH = STEPPING | EXCHANGE } flex_kind;

#define SOLVED_PHASE (EVENT_MODE | CONTINUOUS_TIME_MODE)
#define RUNNING_PHASE (STEPPING_PHASE | SOLVED_PHASE)
#define SETTABLE_PHASE (INSTANTIATED | INITIALISATION_MODE | STEPPING_PHASE | EVENT_MODE)
#define READABLE_PHASE (INITIALISATION_MODE | RUNNING_PHASE | TERMINATED)
#define ANY_PHASE (INSTANTIATED | READABLE_PHASE)

#endif

/* An importer that hears what an FMU logs and counts the memory that it takes. */
#ifndef FLEXFMU_TEST_IMPORTER_H
#define FLEXFMU_TEST_IMPORTER_H

#include <stdio.h>
#include <stdlib.h>

#include "fmi2_instance.h"

/* what is being done, for the sentence of a failed check; FUZZ_TRACE=1 in the environment shows all of it */
extern const char *importer_doing;

#define CHECK(condition)                                                                        \
  do {                                                                                          \
    if (!(condition)) {                                                                         \
      fprintf(stderr, "%s:%d: %s: not true: %s\n", __FILE__, __LINE__, importer_doing, #condition); \
      abort();                                                                                  \
    }                                                                                           \
  } while (0)

typedef struct {
  int n_heard[N_LOG_CATEGORIES]; /* messages, by category */
  fmi2Status status;             /* of the last message */
  char message[1024];
} importer;

fmi2Component importer_instantiate(importer *ear, fmi2Type type, const char *guid, fmi2Boolean logging);

/* the next allocation gives no memory */
void importer_runs_out_of_memory(void);

/* pieces of memory that FMUs have not given back */
int importer_live(void);

#endif

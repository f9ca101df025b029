/* An importer that hears what an FMU logs and counts the memory that it takes. */
#ifndef FLEXFMU_TEST_IMPORTER_H
#define FLEXFMU_TEST_IMPORTER_H

#include <stdarg.h>
#include <string.h>

#include "check.h"
#include "instance.h"

typedef struct {
  int n_heard[N_LOG_CATEGORIES]; /* messages, by category */
  int n_messages;
  fmi2Status status; /* of the last message */
  char message[1024];
} importer;

/* pieces of memory: that FMUs have taken since the last instantiation, that they have not given back; the next one is missing */
static int n_allocations, n_live, is_out_of_memory;

static void hear(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
  importer *ear = environment;
  va_list arguments;
  va_start(arguments, message);
  int length = vsnprintf(ear->message, sizeof ear->message, message, arguments);
  va_end(arguments);

  // a text, from somebody, of a kind that the model description lists
  CHECK(length > 5 && name != NULL);
  int known = 0;
  while (known < N_LOG_CATEGORIES && strcmp(category, flex_log_categories[known]) != 0) known++;
  CHECK(known < N_LOG_CATEGORIES);
  ear->n_heard[known]++, ear->n_messages++;
  ear->status = status;
}

// dirty memory: an importer need not clear it
static void *give(size_t count, size_t size) {
  void *memory = is_out_of_memory ? NULL : malloc(count * size);
  is_out_of_memory = 0;
  if (memory) memset(memory, 0xa5, count * size), n_allocations++, n_live++;
  return memory;
}

static void take_back(void *memory) {
  if (memory) n_live--;
  free(memory);
}

static fmi2Component instantiate(importer *ear, fmi2Type type, const char *name, const char *guid, fmi2Boolean logging) {
  memset(ear, 0, sizeof *ear);
  n_allocations = 0;
  const fmi2CallbackFunctions callbacks = {hear, give, take_back, NULL, ear};
  return fmi2Instantiate(name, type, guid, "file:///nowhere at all", &callbacks, fmi2False, logging);
}

#endif

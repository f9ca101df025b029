#include "importer.h"

#include <stdarg.h>
#include <string.h>

const char *importer_doing = "starting";

static int n_live, is_out_of_memory;

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
  ear->n_heard[known]++;
  ear->status = status;
}

// dirty memory: an importer need not clear it
static void *give(size_t count, size_t size) {
  if (is_out_of_memory) {
    is_out_of_memory = 0;
    return NULL;
  }
  void *memory = malloc(count * size);
  if (memory) memset(memory, 0xa5, count * size), n_live++;
  return memory;
}

static void take_back(void *memory) {
  if (memory) n_live--;
  free(memory);
}

fmi2Component importer_instantiate(importer *ear, fmi2Type type, const char *guid, fmi2Boolean logging) {
  memset(ear, 0, sizeof *ear);
  const fmi2CallbackFunctions callbacks = {hear, give, take_back, NULL, ear};
  return fmi2Instantiate("fuzzed", type, guid, "file:///nowhere at all", &callbacks, fmi2False, logging);
}

void importer_runs_out_of_memory(void) {
  is_out_of_memory = 1;
}

int importer_live(void) {
  return n_live;
}

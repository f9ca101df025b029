/* What an importer in JavaScript can't give a module in WebAssembly: the callbacks of an instance, and the last message. */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

static char said[1024];

static void listen(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
  (void)environment, (void)instance, (void)status, (void)category;
  strncpy(said, message, sizeof said - 1);
}

static const fmi2CallbackFunctions callbacks = {listen, calloc, free, NULL, NULL};

FMI2_Export const void *wasm_callbacks(void) {
  return &callbacks;
}

FMI2_Export const char *wasm_message(void) {
  return said;
}

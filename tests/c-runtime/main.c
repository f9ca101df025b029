/* Runs the tests named on the command line; without names, lists them all. */
#include <stdio.h>
#include <string.h>

#include "tests.h"

static const struct {
  const char *name;
  void (*run)(void);
} tests[] = {
#define X(name) {#name, test_##name},
    TESTS(X)
#undef X
};

#define N_TESTS (sizeof tests / sizeof *tests)

int main(int count, char **names) {
  for (size_t i = 0; count == 1 && i < N_TESTS; i++) printf("%s\n", tests[i].name);
  for (int k = 1; k < count; k++) {
    int found = 0;
    for (size_t i = 0; i < N_TESTS; i++)
      if (strcmp(names[k], tests[i].name) == 0) {
        tests[i].run();
        found = 1;
      }
    if (!found) {
      printf("no test is named '%s'\n", names[k]);
      return 2;
    }
  }
  return 0;
}

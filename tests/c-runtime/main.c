/* Runs the tests named on the command line; without names, lists them all. */
#include <stdio.h>
#include <string.h>

#include "tests.h"

test *all_tests;

int main(int count, char **names) {
  int found = 0;
  for (test *each = all_tests; each; each = each->next) {
    if (count == 1) printf("%s\n", each->name);
    for (int k = 1; k < count; k++)
      if (strcmp(names[k], each->name) == 0) each->run(), found++;
  }
  return found == count - 1 ? 0 : 2;
}

/* Drawn sequences for compilers without libFuzzer. Arguments: how many, and the number of the first, which alone decides what
 * it is; after a failure that one can be run again with FUZZ_TRACE=1. */
#define _POSIX_C_SOURCE 200112L

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "fuzzed_calls.h"

enum { LONGEST = 400, PATIENCE = 60 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

// SplitMix64 (Steele, Lea, Flood 2014)
static uint64_t draw(uint64_t *state) {
  uint64_t z = (*state += 0x9e3779b97f4a7c15ULL);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31);
}

int main(int argc, char **argv) {
  unsigned long count = argc > 1 ? strtoul(argv[1], NULL, 10) : 1000, first = argc > 2 ? strtoul(argv[2], NULL, 10) : 0;
  static unsigned long current;
  for (current = first; current < first + count; current++) {
    uint8_t bytes[LONGEST];
    uint64_t state = current;
    size_t size = 8 + draw(&state) % (LONGEST - 8);
    for (size_t i = 0; i < size; i++) bytes[i] = (uint8_t)(draw(&state) >> 56);

    // nothing hangs
    alarm(PATIENCE);
    if (getenv("FUZZ_TRACE")) fprintf(stderr, "sequence %lu\n", current);
    LLVMFuzzerTestOneInput(bytes, size);
  }
  printf("%lu sequences, %lu calls\n", count, fuzzed_count);
  return 0;
}

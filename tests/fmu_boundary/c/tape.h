/* Bytes that decide what is called with which arguments; behind their end there are zeros. */
#ifndef FLEXFMU_TEST_TAPE_H
#define FLEXFMU_TEST_TAPE_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
  const uint8_t *bytes;
  size_t size, at;
} tape;

unsigned tape_byte(tape *tape);

/* a number: mostly between -0.5 and 0.5, else one of those that programmers forget */
double tape_real(tape *tape);

/* one of 0 .. count - 1 mostly, else beyond */
unsigned tape_index(tape *tape, unsigned count);

#endif

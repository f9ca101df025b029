/* Reads lines "function x y", numbers as the hexadecimal digits of their bits, and prints the bits of each result. */
#include "elementary.h"

#include <inttypes.h>
#include <stdio.h>

#define OF_ONE(X) X(sin) X(cos) X(tan) X(asin) X(acos) X(atan) X(exp) X(expm1) X(sinh) X(cosh) X(tanh) X(erf) X(log) X(log1p) \
  X(asinh) X(acosh) X(atanh) X(floor) X(ceil)
#define OF_TWO(X) X(atan2) X(pow) X(hypot) X(fmod) X(remainder) X(fmin) X(fmax) X(copysign)

static double result_of(const char *name, double x, double y) {
#define X(function) if (strcmp(name, #function) == 0) return elementary_##function(x);
  OF_ONE(X)
#undef X
#define X(function) if (strcmp(name, #function) == 0) return elementary_##function(x, y);
  OF_TWO(X)
#undef X
  return strcmp(name, "ldexp") == 0 ? elementary_ldexp(x, (int)y) : NAN;
}

int main(void) {
  char name[16];
  uint64_t x, y;
  while (scanf("%15s %" SCNx64 " %" SCNx64, name, &x, &y) == 3)
    printf("%016" PRIx64 "\n", flex_bits(result_of(name, flex_double(x), flex_double(y))));
  return 0;
}

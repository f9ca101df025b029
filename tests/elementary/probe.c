/* Reads lines "function x y", numbers as the hexadecimal digits of their bits, and prints the bits of each result. */
#include "elementary.h"
#include "lanes_math.h"

#include <inttypes.h>
#include <stdio.h>

#define OF_ONE(X) X(sin) X(cos) X(tan) X(asin) X(acos) X(atan) X(exp) X(expm1) X(sinh) X(cosh) X(tanh) X(erf) X(log) X(log1p) \
  X(asinh) X(acosh) X(atanh) X(floor) X(ceil)
#define OF_TWO(X) X(atan2) X(pow) X(hypot) X(fmod) X(remainder) X(fmin) X(fmax) X(copysign)

/* sine or cosine beside those of other angles, of which none is far, tiny or no number: these go through the scalar function */
#ifdef FLEX_LANES
FLEX_WIDE static double beside_others(double x, int is_cosine) {
  double angles[FLEX_LANES] = {0.5, x, -2.0, 100.0};
  flex_lanes lanes = flex_load(angles);
  flex_store(angles, is_cosine ? flex_lanes_cos(lanes) : flex_lanes_sin(lanes));
  return angles[1];
}
#else
static double beside_others(double x, int is_cosine) { return is_cosine ? elementary_cos(x) : elementary_sin(x); }
#endif

static double result_of(const char *name, double x, double y) {
#define X(function) if (strcmp(name, #function) == 0) return elementary_##function(x);
  OF_ONE(X)
#undef X
#define X(function) if (strcmp(name, #function) == 0) return elementary_##function(x, y);
  OF_TWO(X)
#undef X
  if (strcmp(name, "lanes_sin") == 0) return beside_others(x, 0);
  if (strcmp(name, "lanes_cos") == 0) return beside_others(x, 1);
  return strcmp(name, "ldexp") == 0 ? elementary_ldexp(x, (int)y) : NAN;
}

int main(void) {
  char name[16];
  uint64_t x, y;
  while (scanf("%15s %" SCNx64 " %" SCNx64, name, &x, &y) == 3)
    printf("%016" PRIx64 "\n", flex_bits(result_of(name, flex_double(x), flex_double(y))));
  return 0;
}

#include "lanes.h"

#ifdef FLEX_LANES
#include <cpuid.h>

/* what the operating system saves when it switches processes */
enum { SSE_AND_AVX_STATE = 6 };

static unsigned saved_states(void) {
  unsigned low, high;
  __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return low;
}

int flex_has_lanes(void) {
  unsigned a, b, c, d;
  if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE) || !(c & bit_AVX)) return 0;
  if ((saved_states() & SSE_AND_AVX_STATE) != SSE_AND_AVX_STATE) return 0;
  return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2);
}
#else
int flex_has_lanes(void) { return 0; }
#endif

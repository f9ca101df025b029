#include "lanes.h"

#ifdef FLEX_LANES
#include <cpuid.h>

/* what the operating system saves when it switches processes */
enum { SSE_AND_AVX_STATE = 6, AVX512_STATE = 0xe6 };

static unsigned saved_states(void) {
  unsigned low, high;
  __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return low;
}

int flex_processor_lanes(void) {
  unsigned a, b, c, d;
  // a question takes microseconds in a virtual machine: each is asked once
  if (__get_cpuid_max(0, 0) < 7) return 1;
  __cpuid(1, a, b, c, d);
  if (!(c & bit_OSXSAVE) || !(c & bit_AVX)) return 1;
  unsigned saved = saved_states();
  if ((saved & SSE_AND_AVX_STATE) != SSE_AND_AVX_STATE) return 1;
  __cpuid_count(7, 0, a, b, c, d);
  if (!(b & bit_AVX2)) return 1;
  return (saved & AVX512_STATE) == AVX512_STATE && (b & bit_AVX512F) && (b & bit_AVX512DQ) ? 8 : 4;
}
#else
int flex_processor_lanes(void) { return 1; }
#endif

int flex_has_lanes(void) { return flex_processor_lanes() > 1; }

#include "tape.h"

#include <float.h>
#include <math.h>

unsigned tape_byte(tape *tape) {
  return tape->at < tape->size ? tape->bytes[tape->at++] : (tape->at++, 0);
}

double tape_real(tape *tape) {
  static const double forgotten[] = {0.0,  -0.0,   NAN,   INFINITY, -INFINITY, DBL_MAX, -DBL_MAX, DBL_MIN,
                                     5e-324, 1e-20, 1e300, 1e18,     -1.0,      1.0,     2.0,      1e4};
  unsigned choice = tape_byte(tape);
  return choice < 208 ? ((double)choice - 104.0) / 208.0 : forgotten[choice % 16];
}

unsigned tape_index(tape *tape, unsigned count) {
  static const unsigned beyond[] = {0, 1, 1000000, 0x7fffffff, 0x80000000, 0xffffffff};
  unsigned choice = tape_byte(tape);
  if (choice < 240 && count > 0) return choice % count;
  return choice % 6 < 2 ? count + beyond[choice % 6] : beyond[choice % 6];
}

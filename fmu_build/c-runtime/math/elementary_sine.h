/* Reduction of any angle, however large or near to a multiple of pi/2. */
#ifndef FLEXFMU_ELEMENTARY_SINE_H
#define FLEXFMU_ELEMENTARY_SINE_H

#include <stdint.h>

#include "elementary_pairs.h"

/* quadrant, of which the last two digits count, and rest, -pi/4..pi/4, of a finite angle above 2^-52; slow */
int64_t flex_reduce_exactly(double x, flex_pair *rest);

#endif

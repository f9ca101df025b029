/* Which of the libraries of variants in lockstep this processor can run: a library of its own, without wide registers. */
#include "batch.h"
#include "lanes.h"

int flex_batch_widest(void) { return flex_processor_lanes(); }

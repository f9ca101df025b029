/* The collocation methods once more, compiled for processors with registers of four doubles (lanes.h). The operations are those of
 * the files below, in the same order, so that the bits are the same; `flex_integrator_use` chooses between the two. */
#if defined(__GNUC__) && !defined(__clang__)
/* as fast as -O3, compiled in half its time; vzeroupper needs `expensive-optimizations` */
#pragma GCC optimize("O1", "expensive-optimizations", "tree-vectorize", "vect-cost-model=dynamic", "inline-functions", \
                     "strict-aliasing", "peel-loops", "unswitch-loops", "tree-vrp")
#endif

#include "lanes.h"
#include "real.h"

#if defined(FLEX_LANES) && FLEX_WIDTH == 1
#include <float.h>
#include <stdlib.h>

#include "lanes_names.h"

#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC push_options
#pragma GCC target("avx2")
#endif

#define FLEX_IN_LANES
#include "lanes_stages.h"
#include "linear_algebra.c"
#include "newton_matrix.c"
#include "prediction.c"
#include "inputs.c"
#include "stages.c"
#include "integration_step.c"
#include "collocation.c"

#ifdef __clang__
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif
#else
typedef int flex_no_lanes; /* a file of ISO C is never empty */
#endif

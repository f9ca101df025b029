/* Four doubles side by side in one register of AVX2: the stages of a step share one evaluation of the residual.
 *
 * Each lane goes through the operations of the scalar code in the same order, so that it gets the same bits; a machine or a
 * compiler without these registers runs the scalar code. Processors are told apart at run time (`flex_has_lanes`).
 * FLEX_PLAIN leaves the lanes out. */
#ifndef FLEXFMU_LANES_H
#define FLEXFMU_LANES_H

/* GCC doesn't align a Windows stack for these registers (its bug 54412) */
#if defined(__x86_64__) && defined(__GNUC__) && (defined(__clang__) || !defined(_WIN32)) && !defined(FLEX_PLAIN) && \
    (!defined(FLEX_WIDTH) || FLEX_WIDTH == 1)
#define FLEX_LANES 4
#endif

/* doubles that the widest registers hold for which this processor and its operating system have what is needed: 8 with AVX-512,
 * 4 with AVX2, otherwise 1 */
int flex_processor_lanes(void);

/* whether this processor and its operating system have the registers, and this library the code for them */
int flex_has_lanes(void);

#endif

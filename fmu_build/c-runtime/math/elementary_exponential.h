/* Exponential and logarithm in twice a double's precision, for all functions that are made of them. */
#ifndef FLEXFMU_ELEMENTARY_EXPONENTIAL_H
#define FLEXFMU_ELEMENTARY_EXPONENTIAL_H

#include "elementary_pairs.h"

/* e^x = result 2^exponent, the result in 0.9..2.1, for |x| below 1e4; relative error 2^-66 */
flex_pair flex_pair_exp(flex_pair x, int *exponent);
/* e^x - 1 for |x| below 700, relative error 2^-59 */
flex_pair flex_pair_expm1(double x);
/* natural logarithm of a positive finite number */
flex_pair flex_pair_log(flex_pair x);

#endif

/* Written by generators/elementary_constants.py; don't edit. */
#ifndef FLEXFMU_ELEMENTARY_SINE_CONSTANTS_H
#define FLEXFMU_ELEMENTARY_SINE_CONSTANTS_H

/* degree 5, weighted error 3.4e-18 */
#define SINE_SERIES(z, z2) ((-0x1.5555555555549p-3 + (z) * 0x1.111111110f87bp-7) + (z2) * ((-0x1.a01a019c11a26p-13 + (z) * 0x1.71de3577be01fp-19) + (z2) * (-0x1.ae5e664028cf7p-26 + (z) * 0x1.5d93028de5563p-33)))
static inline double sine_series(double z) {
  double z2 = z * z;
  return SINE_SERIES(z, z2);
}
/* degree 5, weighted error 4.7e-20 */
#define COSINE_SERIES(z, z2) ((0x1.555555555554cp-5 + (z) * -0x1.6c16c16c1517ep-10) + (z2) * ((0x1.a01a019cb1bd1p-16 + (z) * -0x1.27e4f809f072bp-22) + (z2) * (0x1.1ee9ebe92648dp-29 + (z) * -0x1.8fae9c783185dp-37)))
static inline double cosine_series(double z) {
  double z2 = z * z;
  return COSINE_SERIES(z, z2);
}
#define HALF_PI_0 0x1.921fb54400000p+0
#define HALF_PI_1 0x1.0b4611a600000p-34
#define HALF_PI_2 0x1.3198a2e037073p-69
#define HALF_PI_HI 0x1.921fb54442d18p+0
#define HALF_PI_LO 0x1.1a62633145c07p-54
#define TWO_OVER_PI 0x1.45f306dc9c883p-1
#define QUARTER_PI 0x1.921fb54442d18p-1
static const uint32_t two_over_pi[37] = {
    0xa2f9836eu, 0x4e441529u, 0xfc2757d1u, 0xf534ddc0u, 0xdb629599u, 0x3c439041u, 0xfe5163abu, 0xdebbc561u, 0xb7246e3au, 0x424dd2e0u,
    0x06492eeau, 0x09d1921cu, 0xfe1deb1cu, 0xb129a73eu, 0xe88235f5u, 0x2ebb4484u, 0xe99c7026u, 0xb45f7e41u, 0x3991d639u, 0x835339f4u,
    0x9c845f8bu, 0xbdf9283bu, 0x1ff897ffu, 0xde05980fu, 0xef2f118bu, 0x5a0a6d1fu, 0x6d367ecfu, 0x27cb09b7u, 0x4f463f66u, 0x9e5fea2du,
    0x7527bac7u, 0xebe5f17bu, 0x3d0739f7u, 0x8a5292eau, 0x6bfb5fb1u, 0x1f8d5d08u, 0x56033046u,
};

#endif

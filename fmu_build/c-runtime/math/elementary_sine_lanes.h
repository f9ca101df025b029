/* Sine and cosine of several angles side by side, through the operations of elementary_sine.c in the same order, for angles that
 * its fast reduction serves; if one lane holds another angle, all go through the scalar function.
 *
 * Included where FLEX_V_LANES vectors FLEX_V of doubles, FLEX_V_BITS of as many 64-bit integers, FLEX_V_INLINE and the names
 * FLEX_V_NAME(x) are defined. A compiler shares the reduction of an angle whose sine and cosine are both asked for. */

/* a where all bits of a lane are set, b where none is */
FLEX_V_INLINE FLEX_V FLEX_V_NAME(choose)(FLEX_V_BITS where, FLEX_V a, FLEX_V b) {
  return (FLEX_V)((where & (FLEX_V_BITS)a) | (~where & (FLEX_V_BITS)b));
}

typedef struct {
  FLEX_V hi, lo;
  FLEX_V_BITS quadrant;
  int is_slow; /* not an angle of the fast reduction */
} FLEX_V_NAME(angles);

/* quadrants and rests of angles; Cody and Waite's method */
FLEX_V_INLINE FLEX_V_NAME(angles) FLEX_V_NAME(reduce)(FLEX_V x) {
  const FLEX_V to_integer = FLEX_V_NAME(all)(0x1.8p52), size = FLEX_V_NAME(fabs)(x);
  FLEX_V shifted = x * FLEX_V_NAME(all)(TWO_OVER_PI) + to_integer, quarters = shifted - to_integer;

  // exact sum of the coarse rest and the next part of pi/2
  FLEX_V coarse = x - quarters * FLEX_V_NAME(all)(HALF_PI_0), next = -quarters * FLEX_V_NAME(all)(HALF_PI_1);
  FLEX_V hi = coarse + next, back = hi - coarse;
  FLEX_V lo = (coarse - (hi - back)) + (next - back);

  // fast sum with the last part; angles of the first quadrant stay as they are
  FLEX_V last = lo - quarters * FLEX_V_NAME(all)(HALF_PI_2), sum = hi + last;
  FLEX_V_BITS is_first = size <= FLEX_V_NAME(all)(QUARTER_PI);
  FLEX_V_NAME(angles) angles;
  angles.hi = FLEX_V_NAME(choose)(is_first, x, sum);
  angles.lo = FLEX_V_NAME(choose)(is_first, FLEX_V_NAME(all)(0.0), last - (sum - hi));
  angles.quadrant = ~is_first & (FLEX_V_BITS)shifted;

  // tiny, huge and no numbers, and rests next to zero
  FLEX_V_BITS is_usual = (size >= FLEX_V_NAME(all)(0x1p-27)) & (size < FLEX_V_NAME(all)(1e6));
  FLEX_V_BITS is_far = (FLEX_V_NAME(fabs)(hi) >= FLEX_V_NAME(all)(0x1p-30)) & (quarters != FLEX_V_NAME(all)(0.0));
  FLEX_V_BITS is_fast = is_usual & (is_first | is_far);
  int64_t all_fast = -1;
  for (int k = 0; k < FLEX_V_LANES; k++) all_fast &= is_fast[k];
  angles.is_slow = !all_fast;
  return angles;
}

/* sines of the angles' quadrants and rests, `turned` by a quarter for cosines */
FLEX_V_INLINE FLEX_V FLEX_V_NAME(sine)(FLEX_V_NAME(angles) x, int turned) {
  const FLEX_V one = FLEX_V_NAME(all)(1.0), half = FLEX_V_NAME(all)(0.5);
  FLEX_V z = x.hi * x.hi, z2 = z * z;

  // sine of the rest
  FLEX_V sine = x.hi + (x.hi * z * SINE_SERIES(z, z2) + x.lo * (one - half * z));

  // cosine of the rest: a fast sum of 1 and -z/2, and what is missing
  FLEX_V drop = -half * z, sum = one + drop, lost = drop - (sum - one);
  FLEX_V cosine = sum + (lost + (z * z * COSINE_SERIES(z, z2) - x.hi * x.lo));

  // which of them, with which sign
  FLEX_V_BITS quadrant = x.quadrant + turned;
  FLEX_V value = FLEX_V_NAME(choose)(-(quadrant & 1), cosine, sine);
  return (FLEX_V)((FLEX_V_BITS)value ^ (quadrant & 2) << 62);
}

FLEX_V_INLINE FLEX_V FLEX_V_NAME(sin)(FLEX_V x) {
  FLEX_V_NAME(angles) angles = FLEX_V_NAME(reduce)(x);
  if (!angles.is_slow) return FLEX_V_NAME(sine)(angles, 0);
  for (int k = 0; k < FLEX_V_LANES; k++) x[k] = elementary_sin(x[k]);
  return x;
}

FLEX_V_INLINE FLEX_V FLEX_V_NAME(cos)(FLEX_V x) {
  FLEX_V_NAME(angles) angles = FLEX_V_NAME(reduce)(x);
  if (!angles.is_slow) return FLEX_V_NAME(sine)(angles, 1);
  for (int k = 0; k < FLEX_V_LANES; k++) x[k] = elementary_cos(x[k]);
  return x;
}

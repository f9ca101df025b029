/* An angle times 2/pi modulo 4 in integers, exactly but for 2^-138: M. H. Payne, R. N. Hanek, Radian reduction for
   trigonometric functions, SIGNUM Newsletter 18 (1983). Digits of 2/pi whose product is a multiple of 4 are left out. */
#include "elementary.h"
#include "elementary_sine.h"
#include "elementary_sine_constants.h"

enum { DIGITS = 7, WORDS = DIGITS + 2, WORD = 32, FRACTION_BITS = 53 };

/* product, least word first, of a fraction of 53 bits and the words of 2/pi from `first` on */
static void multiply(uint64_t fraction, int first, uint32_t *product) {
  uint64_t low = (uint32_t)fraction, high = fraction >> WORD, carry = 0, previous = 0;
  for (int i = 0; i < WORDS; i++) {
    uint64_t word = i < DIGITS ? two_over_pi[first + DIGITS - 1 - i] : 0;
    uint64_t lower = low * word, upper = high * previous;
    carry += (lower & UINT32_MAX) + (upper & UINT32_MAX);
    product[i] = (uint32_t)carry;
    carry = (carry >> WORD) + (lower >> WORD) + (upper >> WORD);
    previous = word;
  }
}

/* left by 0 < shift < 32 WORDS; what goes beyond is a multiple of 4 */
static void shift_left(uint32_t *words, int shift) {
  int whole = shift / WORD, part = shift % WORD;
  for (int i = WORDS - 1; i >= 0; i--) {
    uint64_t upper = i >= whole ? words[i - whole] : 0, lower = i > whole ? words[i - whole - 1] : 0;
    words[i] = (uint32_t)((upper << WORD | lower) << part >> WORD);
  }
}

static void negate(uint32_t *words) {
  uint64_t carry = 1;
  for (int i = 0; i < WORDS; i++) {
    carry += (uint32_t)~words[i];
    words[i] = (uint32_t)carry;
    carry >>= WORD;
  }
}

/* the words behind a binary point */
static flex_pair sum_of_words(const uint32_t *words) {
  flex_pair sum = {0.0, 0.0};
  double unit = 1.0;
  for (int i = WORDS - 1; i >= 0; i--) {
    unit *= 0x1p-32;
    flex_pair added = flex_exact_sum(sum.hi, words[i] * unit);
    sum = (flex_pair){added.hi, sum.lo + added.lo};
  }
  return flex_fast_sum(sum.hi, sum.lo);
}

int64_t flex_reduce_exactly(double x, flex_pair *rest) {
  // |x| = fraction 2^exponent
  int exponent = flex_exponent(x) - (FRACTION_BITS - 1);
  uint64_t fraction = (flex_bits(x) & (((uint64_t)1 << 52) - 1)) | (uint64_t)1 << 52;
  // the product's last digit is worth 2^(exponent - 32 (first + DIGITS))
  int first = exponent > 2 ? (exponent - 2) / WORD : 0;
  uint32_t words[WORDS];
  multiply(fraction, first, words);
  // two digits of the integer part in front of everything, then the fraction alone
  shift_left(words, WORD * WORDS - 2 + exponent - WORD * (first + DIGITS));
  int64_t quadrant = words[WORDS - 1] >> (WORD - 2);
  shift_left(words, 2);
  // to the nearest quarter
  int is_beyond = (int)(words[WORDS - 1] >> (WORD - 1));
  if (is_beyond) negate(words);
  flex_pair angle = flex_pair_product(sum_of_words(words), (flex_pair){HALF_PI_HI, HALF_PI_LO});
  int is_negative = is_beyond != flex_is_negative(x);
  *rest = is_negative ? flex_negative(angle) : angle;
  return flex_is_negative(x) ? -(quadrant + is_beyond) : quadrant + is_beyond;
}

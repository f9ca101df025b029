/* LU with partial pivoting, inverses and Cholesky's factors L D L' without roots, for matrices of some ten rows (sources: linear_algebra.h).
 * All work goes along columns, two at a time, in loops that compilers turn into vector instructions. */
#include "linear_algebra.h"

#include <math.h>
#include <string.h>

#ifdef FLEX_IN_LANES
#include "lanes_stages.h"
#endif

// y += f0 x0 + f1 x1; without aliases and in pairs, which compilers turn into vector instructions also where they are careful
static inline void add_two(int n, real f0, const real *restrict x0, real f1, const real *restrict x1,
                           real *restrict y) {
  int i = 0;
  for (; i + 2 <= n; i += 2) {
    y[i] = y[i] + f0 * x0[i] + f1 * x1[i];
    y[i + 1] = y[i + 1] + f0 * x0[i + 1] + f1 * x1[i + 1];
  }
  if (i < n) y[i] = y[i] + f0 * x0[i] + f1 * x1[i];
}

// y += f x
static inline void add_one(int n, real f, const real *restrict x, real *restrict y) {
  int i = 0;
  for (; i + 2 <= n; i += 2) {
    y[i] += f * x[i];
    y[i + 1] += f * x[i + 1];
  }
  if (i < n) y[i] += f * x[i];
}

// from the last product to the first, which substitutions know last
static inline real dot(int n, const real *restrict x, const real *restrict y) {
  real even = flex_real(0.0), odd = even;
  int i = n;
  for (; i >= 2; i -= 2) {
    odd += x[i - 1] * y[i - 1];
    even += x[i - 2] * y[i - 2];
  }
  if (i == 1) even += x[0] * y[0];
  return even + odd;
}

// the same for complex numbers: y -= f x
static inline void subtract_complex(int n, const real *f, const real *restrict x, real *restrict y) {
  real re = f[0], im = f[1], minus_im = -f[1];
  for (int i = 0; i < n; i++) {
    real x_re = x[2 * i], x_im = x[2 * i + 1];
    y[2 * i] -= re * x_re + minus_im * x_im;
    y[2 * i + 1] -= re * x_im + im * x_re;
  }
}

// y = f0 x0 + f1 x1
static inline void set_two(int n, real f0, const real *restrict x0, real f1, const real *restrict x1,
                           real *restrict y) {
  int i = 0;
  for (; i + 2 <= n; i += 2) {
    y[i] = f0 * x0[i] + f1 * x1[i];
    y[i + 1] = f0 * x0[i + 1] + f1 * x1[i + 1];
  }
  if (i < n) y[i] = f0 * x0[i] + f1 * x1[i];
}

void flex_combine(int n, int count, const double *factors, const real *columns, real *y) {
  int j = 2;
  if (count == 1) {
    for (int i = 0; i < n; i++) y[i] = factors[0] * columns[i];
    return;
  }
  set_two(n, flex_real(factors[0]), columns, flex_real(factors[1]), columns + n, y);
  for (; j + 2 <= count; j += 2)
    add_two(n, flex_real(factors[j]), columns + j * n, flex_real(factors[j + 1]), columns + (j + 1) * n, y);
  if (j < count) add_one(n, flex_real(factors[j]), columns + j * n, y);
}

static void swap_rows(int columns, int stride, int width, real *a, int i, int k) {
  if (i == k) return;
  for (int j = 0; j < columns; j++)
    for (int c = 0; c < width; c++) {
      real *column = a + j * stride + c;
      real kept = column[i * width];
      column[i * width] = column[k * width];
      column[k * width] = kept;
    }
}

// size of an entry of `width` numbers
static inline real entry_size(int width, const real *x) {
  return width == 1 ? flex_fabs(x[0]) : flex_fabs(x[0]) + flex_fabs(x[1]);
}

// row with the largest entry of a column; of several lanes the least entry counts, in units of the lane's largest
static inline int find_pivot(int rows, int width, const real *column) {
  real unit = flex_real(1.0);
  if (FLEX_WIDTH > 1) {
    real largest = flex_real(0.0);
    for (int i = 0; i < rows; i++) largest = flex_larger(largest, entry_size(width, column + width * i));
    unit = 1.0 / largest;
  }
  int pivot = 0;
  double best = flex_least_of(entry_size(width, column), unit);
  for (int i = 1; i < rows; i++) {
    double size = flex_least_of(entry_size(width, column + width * i), unit);
    if (size > best) best = size, pivot = i;
  }
  return pivot;
}

int flex_lu_factor(int n, real *a, int *pivots) {
  for (int k = 0; k < n; k++) {
    real *column = a + k * n;

    // largest entry of the column becomes the pivot
    int pivot = k + find_pivot(n - k, 1, column + k);
    pivots[k] = pivot;
    swap_rows(n, n, 1, a, k, pivot);
    if (!flex_is_finite(column[k]) || flex_has_zero(column[k])) return 1;

    // multipliers
    real inverse = 1.0 / column[k];
    column[k] = inverse;
    for (int i = k + 1; i < n; i++) column[i] *= inverse;

    // rank-one update of the rest
    for (int j = k + 1; j < n; j++) {
      real *target = a + j * n;
      add_one(n - k - 1, -target[k], column + k + 1, target + k + 1);
    }
  }
  return 0;
}

static void permute(int n, const int *pivots, real *x) {
  for (int k = 0; k < n; k++) {
    real kept = x[k];
    x[k] = x[pivots[k]];
    x[pivots[k]] = kept;
  }
}

void flex_lu_solve(int n, const real *lu, const int *pivots, real *x) {
  permute(n, pivots, x);
  for (int k = 0; k < n; k++) add_one(n - k - 1, -x[k], lu + k * n + k + 1, x + k + 1);
  for (int k = n - 1; k >= 0; k--) {
    x[k] *= lu[k * n + k];
    add_one(k, -x[k], lu + k * n, x);
  }
}

// x = f x
static inline void multiply_complex(const real *f, real *x) {
  real re = x[0] * f[0] - x[1] * f[1], im = x[0] * f[1] + x[1] * f[0];
  x[0] = re;
  x[1] = im;
}

#ifdef FLEX_IN_LANES
static inline void multiply_four(int n, const double *a, const double *x, double *y) {
  flex_four sum = {0.0};
  for (int j = 0; j < n; j++) sum += x[j] * flex_load_four(a + j * n);
  flex_store_four(y, sum);
}

static inline void multiply_two_complex(int n, const double *a, const double *x, double *y) {
  flex_four by_re = {0.0}, by_im = {0.0};
  for (int j = 0; j < n; j++) {
    flex_four column = flex_load_four(a + 2 * j * n);
    by_re += x[2 * j] * column;
    by_im += x[2 * j + 1] * column;
  }
  const double rows[4] = {by_re[0] - by_im[1], by_re[1] + by_im[0], by_re[2] - by_im[3], by_re[3] + by_im[2]};
  memcpy(y, rows, sizeof rows);
}
#else
static void multiply_four(int n, const real *a, const real *x, real *restrict y) {
  real s0 = flex_real(0.0), s1 = s0, s2 = s0, s3 = s0;
  for (int j = 0; j < n; j++, a += n) {
    s0 += x[j] * a[0];
    s1 += x[j] * a[1];
    s2 += x[j] * a[2];
    s3 += x[j] * a[3];
  }
  y[0] = s0, y[1] = s1, y[2] = s2, y[3] = s3;
}

static void multiply_two_complex(int n, const real *a, const real *x, real *restrict y) {
  real p0 = flex_real(0.0), p1 = p0, p2 = p0, p3 = p0, q0 = p0, q1 = p0, q2 = p0, q3 = p0;
  for (int j = 0; j < n; j++, x += 2, a += 2 * n) {
    p0 += x[0] * a[0], q0 += x[1] * a[0];
    p1 += x[0] * a[1], q1 += x[1] * a[1];
    p2 += x[0] * a[2], q2 += x[1] * a[2];
    p3 += x[0] * a[3], q3 += x[1] * a[3];
  }
  y[0] = p0 - q1, y[1] = p1 + q0, y[2] = p2 - q3, y[3] = p3 + q2;
}
#endif

// one row of A x, of which every `step`-th entry counts
static real row(int n, const real *a, int stride, const real *x, int step) {
  real sum = flex_real(0.0);
  for (int j = 0; j < n; j++) sum += x[j * step] * a[j * stride];
  return sum;
}

void flex_multiply(int n, const real *matrix, const real *x, real *y) {
  int i = 0;
  for (; i + 4 <= n; i += 4) multiply_four(n, matrix + i, x, y + i);
  for (; i < n; i++) y[i] = row(n, matrix + i, n, x, 1);
}

// two rows at once: what real parts of x make of them, what imaginary parts do
void flex_complex_multiply(int n, const real *matrix, const real *x, real *y) {
  int i = 0;
  for (; i + 2 <= n; i += 2) multiply_two_complex(n, matrix + 2 * i, x, y + 2 * i);
  if (i == n) return;
  y[2 * i] = row(n, matrix + 2 * i, 2 * n, x, 2) - row(n, matrix + 2 * i + 1, 2 * n, x + 1, 2);
  y[2 * i + 1] = row(n, matrix + 2 * i + 1, 2 * n, x, 2) + row(n, matrix + 2 * i, 2 * n, x + 1, 2);
}

// columns of an inverse in the order of its rows' exchanges
static void exchange_columns(int n, int width, const int *pivots, real *a) {
  for (int k = n - 1; k >= 0; k--)
    for (int i = 0; i < width * n && pivots[k] != k; i++) {
      real *left = a + k * width * n + i, *right = a + pivots[k] * width * n + i, kept = *left;
      *left = *right;
      *right = kept;
    }
}

int flex_invert(int n, real *a, int *pivots) {
  for (int k = 0; k < n; k++) {
    real *column = a + k * n;

    // largest entry of the column becomes the pivot
    pivots[k] = k + find_pivot(n - k, 1, column + k);
    swap_rows(n, n, 1, a, k, pivots[k]);
    if (!flex_is_finite(column[k]) || flex_has_zero(column[k])) return 1;
    real inverse = 1.0 / column[k];

    // unknown k eliminated from all rows, and replaced by the right-hand side k
    for (int j = 0; j < n; j++) {
      real *target = a + j * n, share = target[k] * inverse;
      if (j == k) continue;
      add_one(n, -share, column, target);
      target[k] = share;
    }
    for (int i = 0; i < n; i++) column[i] *= -inverse;
    column[k] = inverse;
  }
  exchange_columns(n, 1, pivots, a);
  return 0;
}

int flex_complex_invert(int n, real *a, int *pivots) {
  for (int k = 0; k < n; k++) {
    real *column = a + 2 * k * n;

    // largest entry of the column becomes the pivot
    pivots[k] = k + find_pivot(n - k, 2, column + 2 * k);
    swap_rows(n, 2 * n, 2, a, k, pivots[k]);
    real re = column[2 * k], im = column[2 * k + 1], square = re * re + im * im;
    if (!flex_is_finite(square) || flex_has_zero(square)) return 1;
    const real inverse[2] = {re / square, -im / square}, opposite[2] = {-inverse[0], -inverse[1]};

    // unknown k eliminated from all rows, and replaced by the right-hand side k
    for (int j = 0; j < n; j++) {
      real *target = a + 2 * j * n, share[2] = {target[2 * k], target[2 * k + 1]};
      if (j == k) continue;
      multiply_complex(inverse, share);
      subtract_complex(n, share, column, target);
      target[2 * k] = share[0];
      target[2 * k + 1] = share[1];
    }
    for (int i = 0; i < n; i++) multiply_complex(opposite, column + 2 * i);
    column[2 * k] = inverse[0];
    column[2 * k + 1] = inverse[1];
  }
  exchange_columns(n, 2, pivots, a);
  return 0;
}

int flex_cholesky_factor(int n, real *a) {
  for (int k = 0; k < n; k++) {
    real *column = a + k * n;
    if (!flex_is_positive(column[k]) || !flex_is_finite(column[k])) return 1;
    real inverse = 1.0 / column[k];

    // rank-one update of the rest, then column k of L
    for (int j = k + 1; j < n; j++) add_one(n - j, -(column[j] * inverse), column + j, a + j * n + j);
    column[k] = inverse;
    for (int i = k + 1; i < n; i++) column[i] *= inverse;
  }
  return 0;
}

void flex_cholesky_solve(int n, const real *l, real *x) {
  // L z = x, two columns at once
  for (int k = 0; k + 2 <= n; k += 2) {
    const real *left = l + k * n + k, *right = left + n;
    x[k + 1] -= x[k] * left[1];
    add_two(n - k - 2, -x[k], left + 2, -x[k + 1], right + 2, x + k + 2);
  }
  for (int k = 0; k < n; k++) x[k] *= l[k * n + k];

  // L' x = D^-1 z, two rows at once
  for (int k = n - 1; k >= 0; k -= 2) {
    const real *lower = l + k * n + k + 1, *upper = lower - n;
    x[k] -= dot(n - k - 1, lower, x + k + 1);
    if (k > 0) x[k - 1] -= dot(n - k - 1, upper, x + k + 1) + upper[-1] * x[k];
  }
}

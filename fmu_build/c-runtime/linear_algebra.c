/* LU with partial pivoting, its complex twin and Cholesky's factors L D L' without roots, for matrices of some ten rows (sources: linear_algebra.h).
 * All work goes along columns, two at a time, in loops that compilers turn into vector instructions. */
#include "linear_algebra.h"

#include <math.h>

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

void flex_multiply(int n, const real *matrix, const real *x, real *y) {
  int j = 0;
  for (int i = 0; i < n; i++) y[i] = flex_real(0.0);
  for (; j + 2 <= n; j += 2) add_two(n, x[j], matrix + j * n, x[j + 1], matrix + (j + 1) * n, y);
  if (j < n) add_one(n, x[j], matrix + j * n, y);
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

// substitution with columns k and k + 1 of the factors
static inline void forward(int n, int k, const real *lu, real *x) {
  const real *left = lu + k * n, *right = left + n;
  x[k + 1] -= x[k] * left[k + 1];
  add_two(n - k - 2, -x[k], left + k + 2, -x[k + 1], right + k + 2, x + k + 2);
}

// with columns k and k - 1, or with the first alone
static inline void backward(int n, int k, const real *lu, real *x) {
  const real *right = lu + k * n, *left = right - n;
  x[k] *= right[k];
  if (k == 0) return;
  x[k - 1] = (x[k - 1] - x[k] * right[k - 1]) * left[k - 1];
  add_two(k - 1, -x[k], right, -x[k - 1], left, x);
}

void flex_lu_solve(int n, const real *lu, const int *pivots, real *x) {
  permute(n, pivots, x);
  for (int k = 0; k + 2 <= n; k += 2) forward(n, k, lu, x);
  for (int k = n - 1; k >= 0; k -= 2) backward(n, k, lu, x);
}

int flex_complex_lu_factor(int n, real *a, int *pivots) {
  for (int k = 0; k < n; k++) {
    real *column = a + 2 * k * n;

    // largest entry of the column becomes the pivot
    int pivot = k + find_pivot(n - k, 2, column + 2 * k);
    pivots[k] = pivot;
    swap_rows(n, 2 * n, 2, a, k, pivot);
    real re = column[2 * k], im = column[2 * k + 1], square = re * re + im * im;
    if (!flex_is_finite(square) || flex_has_zero(square)) return 1;

    // multipliers
    re /= square;
    im /= -square;
    column[2 * k] = re;
    column[2 * k + 1] = im;
    for (int i = k + 1; i < n; i++) {
      real x = column[2 * i], y = column[2 * i + 1];
      column[2 * i] = x * re - y * im;
      column[2 * i + 1] = x * im + y * re;
    }

    // rank-one update of the rest
    for (int j = k + 1; j < n; j++) {
      real *target = a + 2 * (j * n + k);
      subtract_complex(n - k - 1, target, column + 2 * (k + 1), target + 2);
    }
  }
  return 0;
}

static void permute_complex(int n, const int *pivots, real *x) {
  for (int k = 0; k < n; k++) swap_rows(1, 0, 2, x, k, pivots[k]);
}

// y -= f0 x0 + f1 x1, one after the other
static inline void subtract_two_complex(int n, const real *f, const real *restrict x0, const real *restrict x1,
                                        real *restrict y) {
  real re0 = f[0], im0 = f[1], minus_im0 = -f[1], re1 = f[2], im1 = f[3], minus_im1 = -f[3];
  for (int i = 0; i < n; i++) {
    real x_re = x0[2 * i], x_im = x0[2 * i + 1], z_re = x1[2 * i], z_im = x1[2 * i + 1];
    y[2 * i] = y[2 * i] - (re0 * x_re + minus_im0 * x_im) - (re1 * z_re + minus_im1 * z_im);
    y[2 * i + 1] = y[2 * i + 1] - (re0 * x_im + im0 * x_re) - (re1 * z_im + im1 * z_re);
  }
}

// substitution with columns k and k + 1 of the factors
static inline void complex_forward(int n, int k, const real *lu, real *x) {
  const real *left = lu + 2 * (k * n + k + 1), *right = left + 2 * n;
  subtract_complex(1, x + 2 * k, left, x + 2 * (k + 1));
  const real values[4] = {x[2 * k], x[2 * k + 1], x[2 * k + 2], x[2 * k + 3]};
  subtract_two_complex(n - k - 2, values, left + 2, right + 2, x + 2 * (k + 2));
}

// x = f x
static inline void multiply_complex(const real *f, real *x) {
  real re = x[0] * f[0] - x[1] * f[1], im = x[0] * f[1] + x[1] * f[0];
  x[0] = re;
  x[1] = im;
}

// with columns k and k - 1, or with the first alone
static inline void complex_backward(int n, int k, const real *lu, real *x) {
  const real *right = lu + 2 * k * n, *left = right - 2 * n;
  multiply_complex(right + 2 * k, x + 2 * k);
  if (k == 0) return;
  subtract_complex(1, x + 2 * k, right + 2 * (k - 1), x + 2 * (k - 1));
  multiply_complex(left + 2 * (k - 1), x + 2 * (k - 1));
  const real values[4] = {x[2 * k], x[2 * k + 1], x[2 * k - 2], x[2 * k - 1]};
  subtract_two_complex(k - 1, values, right, left, x);
}

void flex_complex_lu_solve(int n, const real *lu, const int *pivots, real *x) {
  permute_complex(n, pivots, x);
  for (int k = 0; k + 2 <= n; k += 2) complex_forward(n, k, lu, x);
  for (int k = n - 1; k >= 0; k -= 2) complex_backward(n, k, lu, x);
}

void flex_lu_solve_both(int n, const real *lu, const int *pivots, real *x, const real *complex_lu,
                        const int *complex_pivots, real *z) {
  permute(n, pivots, x);
  permute_complex(n, complex_pivots, z);
  for (int k = 0; k + 2 <= n; k += 2) {
    forward(n, k, lu, x);
    complex_forward(n, k, complex_lu, z);
  }
  for (int k = n - 1; k >= 0; k -= 2) {
    backward(n, k, lu, x);
    complex_backward(n, k, complex_lu, z);
  }
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

#include "linear_algebra.h"

#include <math.h>

static void swap_rows(int columns, int stride, int width, double *a, int i, int k) {
  if (i == k) return;
  for (int j = 0; j < columns; j++)
    for (int c = 0; c < width; c++) {
      double *column = a + j * stride + c;
      double kept = column[i * width];
      column[i * width] = column[k * width];
      column[k * width] = kept;
    }
}

int flex_lu_factor(int n, double *a, int *pivots) {
  for (int k = 0; k < n; k++) {
    double *column = a + k * n;

    // largest entry of the column becomes the pivot
    int pivot = k;
    for (int i = k + 1; i < n; i++)
      if (fabs(column[i]) > fabs(column[pivot])) pivot = i;
    pivots[k] = pivot;
    swap_rows(n, n, 1, a, k, pivot);
    if (!isfinite(column[k]) || column[k] == 0.0) return 1;

    // multipliers
    double inverse = 1.0 / column[k];
    column[k] = inverse;
    for (int i = k + 1; i < n; i++) column[i] *= inverse;

    // rank-one update of the rest
    for (int j = k + 1; j < n; j++) {
      double *target = a + j * n;
      double factor = target[k];
      for (int i = k + 1; i < n; i++) target[i] -= factor * column[i];
    }
  }
  return 0;
}

void flex_lu_solve(int n, const double *lu, const int *pivots, double *x) {
  // permute
  for (int k = 0; k < n; k++) {
    double kept = x[k];
    x[k] = x[pivots[k]];
    x[pivots[k]] = kept;
  }

  // forward, then backward substitution
  for (int k = 0; k < n; k++) {
    const double *column = lu + k * n;
    double factor = x[k];
    for (int i = k + 1; i < n; i++) x[i] -= factor * column[i];
  }
  for (int k = n - 1; k >= 0; k--) {
    const double *column = lu + k * n;
    double factor = x[k] *= column[k];
    for (int i = 0; i < k; i++) x[i] -= factor * column[i];
  }
}

int flex_complex_lu_factor(int n, double *a, int *pivots) {
  for (int k = 0; k < n; k++) {
    double *column = a + 2 * k * n;

    // largest entry of the column becomes the pivot
    int pivot = k;
    double largest = fabs(column[2 * k]) + fabs(column[2 * k + 1]);
    for (int i = k + 1; i < n; i++) {
      double size = fabs(column[2 * i]) + fabs(column[2 * i + 1]);
      if (size > largest) largest = size, pivot = i;
    }
    pivots[k] = pivot;
    swap_rows(n, 2 * n, 2, a, k, pivot);
    double re = column[2 * k], im = column[2 * k + 1], square = re * re + im * im;
    if (!isfinite(square) || square == 0.0) return 1;

    // multipliers
    re /= square;
    im /= -square;
    column[2 * k] = re;
    column[2 * k + 1] = im;
    for (int i = k + 1; i < n; i++) {
      double x = column[2 * i], y = column[2 * i + 1];
      column[2 * i] = x * re - y * im;
      column[2 * i + 1] = x * im + y * re;
    }

    // rank-one update of the rest
    for (int j = k + 1; j < n; j++) {
      double *target = a + 2 * j * n;
      double fr = target[2 * k], fi = target[2 * k + 1];
      for (int i = k + 1; i < n; i++) {
        target[2 * i] -= fr * column[2 * i] - fi * column[2 * i + 1];
        target[2 * i + 1] -= fr * column[2 * i + 1] + fi * column[2 * i];
      }
    }
  }
  return 0;
}

void flex_complex_lu_solve(int n, const double *lu, const int *pivots, double *x) {
  // permute
  for (int k = 0; k < n; k++) swap_rows(1, 0, 2, x, k, pivots[k]);

  // forward, then backward substitution
  for (int k = 0; k < n; k++) {
    const double *column = lu + 2 * k * n;
    double fr = x[2 * k], fi = x[2 * k + 1];
    for (int i = k + 1; i < n; i++) {
      x[2 * i] -= fr * column[2 * i] - fi * column[2 * i + 1];
      x[2 * i + 1] -= fr * column[2 * i + 1] + fi * column[2 * i];
    }
  }
  for (int k = n - 1; k >= 0; k--) {
    const double *column = lu + 2 * k * n;
    double re = column[2 * k], im = column[2 * k + 1];
    double fr = x[2 * k] * re - x[2 * k + 1] * im, fi = x[2 * k] * im + x[2 * k + 1] * re;
    x[2 * k] = fr;
    x[2 * k + 1] = fi;
    for (int i = 0; i < k; i++) {
      x[2 * i] -= fr * column[2 * i] - fi * column[2 * i + 1];
      x[2 * i + 1] -= fr * column[2 * i + 1] + fi * column[2 * i];
    }
  }
}

int flex_cholesky_factor(int n, double *a) {
  for (int k = 0; k < n; k++) {
    double *column = a + k * n;

    // column k of L
    if (!(column[k] > 0.0) || !isfinite(column[k])) return 1;
    double inverse = 1.0 / sqrt(column[k]);
    column[k] = inverse;
    for (int i = k + 1; i < n; i++) column[i] *= inverse;

    // update of the columns to the right, lower triangle
    for (int j = k + 1; j < n; j++) {
      double *target = a + j * n;
      double factor = column[j];
      for (int i = j; i < n; i++) target[i] -= factor * column[i];
    }
  }
  return 0;
}

void flex_cholesky_solve(int n, const double *l, double *x) {
  // L z = x
  for (int k = 0; k < n; k++) {
    const double *column = l + k * n;
    double factor = x[k] *= column[k];
    for (int i = k + 1; i < n; i++) x[i] -= factor * column[i];
  }

  // L' x = z
  for (int k = n - 1; k >= 0; k--) {
    const double *column = l + k * n;
    double sum = x[k];
    for (int i = k + 1; i < n; i++) sum -= column[i] * x[i];
    x[k] = sum * column[k];
  }
}

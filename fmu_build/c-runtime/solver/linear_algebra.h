/* Small dense systems. Matrices are stored by columns; complex numbers are pairs (real, imaginary).
 *
 * Golub, Van Loan: Matrix Computations, 4th edition, algorithms 3.4.1 and 4.2.2. */
#ifndef FLEXFMU_LINEAR_ALGEBRA_H
#define FLEXFMU_LINEAR_ALGEBRA_H

#include "real.h"

/* y [n] = the sum of factors [count] times columns [count n], count > 0; y is none of them */
void flex_combine(int n, int count, const double *factors, const real *columns, real *y);

/* y = A x; y is neither of them */
void flex_multiply(int n, const real *a, const real *x, real *y);

/* LU = P A in place, pivots [n]; the diagonal of U is stored inverted. Returns 0, or 1 if a pivot is zero or not finite. */
int flex_lu_factor(int n, real *a, int *pivots);

/* x = inverse(A) x with the factors above */
void flex_lu_solve(int n, const real *lu, const int *pivots, real *x);

/* inverse(A) in place of A, pivots [n] are scratch (Gauss and Jordan's method). Its product with a vector waits for nothing, where
 * a solution with factors is a chain of operations. Returns 0, or 1 if a pivot is zero or not finite. */
int flex_invert(int n, real *a, int *pivots);

/* the same for complex matrices, a [2 n n], and y = A x, which are of [2 n] */
int flex_complex_invert(int n, real *a, int *pivots);
void flex_complex_multiply(int n, const real *a, const real *x, real *y);

/* A = L D L' in place, lower triangle; in place of the unit diagonal of L the inverse of D. Returns 0, or 1 if A is not positive
 * definite. */
int flex_cholesky_factor(int n, real *a);

/* x = inverse(A) x with the factor above */
void flex_cholesky_solve(int n, const real *l, real *x);

#endif

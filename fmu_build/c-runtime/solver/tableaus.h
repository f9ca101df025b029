/* Collocation methods and explicit Runge-Kutta methods as data: nodes c, weights b and the matrix A.
 *
 * A Gauss method of s stages has order 2 s, is A-stable and symplectic: it damps nothing. Radau IIA has order 2 s - 1 and
 * is L-stable: it damps what it doesn't resolve. For equations of second order the stage positions need A*A and the end
 * position the weights b_i (1 - c_i) (Hairer, Norsett, Wanner: Solving Ordinary Differential Equations I, section II.14).
 *
 * A is diagonal in the basis of its eigenvectors, so that Newton's method on s n unknowns splits into one system of n
 * unknowns for every eigenvalue (Butcher 1976; Hairer, Wanner: Solving ODEs II, section IV.8). Only one of two conjugate
 * eigenvalues is listed: left is a row of the inverse of the eigenvectors, right a column of the eigenvectors, twice
 * that column for complex eigenvalues, where the real part of the product is taken.
 *
 * The numbers were computed with 60 digits from the nodes. */
#ifndef FLEXFMU_TABLEAUS_H
#define FLEXFMU_TABLEAUS_H

#include "private.h"

#define FLEX_MAX_STAGES 4
#define FLEX_MAX_BLOCKS 2
#define FLEX_DENSE_NODES 4
#define FLEX_MAX_EXPLICIT_STAGES 7

/* a real eigenvalue of A, or one of a complex pair; imaginary parts are zero for a real one */
typedef struct {
  int is_complex;
  double value[2];
  double left[FLEX_MAX_STAGES][2];
  double right[FLEX_MAX_STAGES][2];
} flex_eigenvalue;

typedef struct {
  int stages, order, n_blocks;
  double c[FLEX_MAX_STAGES];
  double b[FLEX_MAX_STAGES];
  double b_position[FLEX_MAX_STAGES]; /* b_i (1 - c_i) */
  double a[FLEX_MAX_STAGES][FLEX_MAX_STAGES];
  double a_squared[FLEX_MAX_STAGES][FLEX_MAX_STAGES];
  double at_start[FLEX_MAX_STAGES]; /* value at 0 of the polynomial through the stages */
  double at_end[FLEX_MAX_STAGES];   /* value at 1 */
  double between[FLEX_DENSE_NODES][FLEX_DENSE_NODES]; /* coefficients by powers of the polynomials of Lagrange through the start and
                                                         three stages, of which the last is the end */
  flex_eigenvalue blocks[FLEX_MAX_BLOCKS]; /* complex pairs, or a real eigenvalue and then a pair */
} flex_tableau;

/* whether the last stage is the end of the step */
static inline int flex_ends_in_stage(const flex_tableau *tableau) {
  return tableau->c[tableau->stages - 1] == 1.0;
}

typedef struct {
  int stages, order;
  int is_embedded; /* 1 = b_error estimates the error; 0 = two steps of half the size do */
  int ends_last;   /* 1 = the last stage is the end of the step, and so the first of the next one */
  double c[FLEX_MAX_EXPLICIT_STAGES];
  double b[FLEX_MAX_EXPLICIT_STAGES];
  double b_error[FLEX_MAX_EXPLICIT_STAGES]; /* b minus the weights of the embedded method */
  double a[FLEX_MAX_EXPLICIT_STAGES][FLEX_MAX_EXPLICIT_STAGES];
} flex_explicit_tableau;

FLEX_PRIVATE const flex_explicit_tableau flex_dormand_prince, flex_runge_kutta_4;
FLEX_PRIVATE const flex_tableau flex_gauss_2, flex_gauss_3, flex_gauss_4, flex_radau_3;

#endif

/* Building blocks: linear solvers, tableaus, input polynomials. */
#include <string.h>

#include "check.h"
#include "inputs.h"
#include "linear_algebra.h"
#include "tableaus.h"
#include "tests.h"

/* minimal standard generator (Park, Miller 1988), the same numbers everywhere; -1 .. 1 */
static double random_number(unsigned long *state) {
  *state = *state * 16807UL % 2147483647UL;
  return (double)*state / 1073741823.5 - 1.0;
}

enum { SIZE = 9 };

static void check_product(int n, const double *a, const double *x, const double *b) {
  for (int i = 0; i < n; i++) {
    double sum = 0.0;
    for (int j = 0; j < n; j++) sum += a[j * n + i] * x[j];
    CHECK_CLOSE(sum, b[i], 1e-12);
  }
}

// a solver that loses digits would stop Newton's iterations early
TEST(linear_solvers_invert) {
  unsigned long seed = 7;
  for (int n = 1; n <= SIZE; n++) {
    double a[SIZE * SIZE], lu[SIZE * SIZE], x[SIZE], b[SIZE], z[2 * SIZE * SIZE], inverse[2 * SIZE * SIZE], zx[2 * SIZE],
        zb[2 * SIZE];
    int pivots[SIZE];
    for (int i = 0; i < n * n; i++) a[i] = random_number(&seed);
    for (int i = 0; i < 2 * n * n; i++) z[i] = random_number(&seed);
    for (int i = 0; i < 2 * n; i++) zb[i] = random_number(&seed);
    for (int i = 0; i < n; i++) b[i] = x[i] = random_number(&seed);

    // real
    memcpy(lu, a, sizeof a);
    CHECK(flex_lu_factor(n, lu, pivots) == 0);
    flex_lu_solve(n, lu, pivots, x);
    check_product(n, a, x, b);

    // the same by the inverse
    double y[SIZE];
    memcpy(inverse, a, sizeof a);
    CHECK(flex_invert(n, inverse, pivots) == 0);
    flex_multiply(n, inverse, b, y);
    for (int i = 0; i < n; i++) CHECK_CLOSE(y[i], x[i], 1e-12);

    // complex
    memcpy(inverse, z, sizeof z);
    CHECK(flex_complex_invert(n, inverse, pivots) == 0);
    flex_complex_multiply(n, inverse, zb, zx);
    for (int i = 0; i < n; i++) {
      double re = 0.0, im = 0.0;
      for (int j = 0; j < n; j++) {
        const double *e = z + 2 * (j * n + i);
        re += e[0] * zx[2 * j] - e[1] * zx[2 * j + 1];
        im += e[0] * zx[2 * j + 1] + e[1] * zx[2 * j];
      }
      CHECK_CLOSE(re, zb[2 * i], 1e-12);
      CHECK_CLOSE(im, zb[2 * i + 1], 1e-12);
    }

    // symmetric: A A' + 1
    double spd[SIZE * SIZE], l[SIZE * SIZE];
    for (int i = 0; i < n; i++)
      for (int j = 0; j < n; j++) {
        spd[j * n + i] = i == j;
        for (int k = 0; k < n; k++) spd[j * n + i] += a[k * n + i] * a[k * n + j];
      }
    memcpy(l, spd, sizeof spd);
    memcpy(x, b, sizeof b);
    CHECK(flex_cholesky_factor(n, l) == 0);
    flex_cholesky_solve(n, l, x);
    check_product(n, spd, x, b);
  }
}

// a singular or poisoned matrix must be reported, not divided by
TEST(linear_solvers_refuse_singular_matrices) {
  int pivots[2];
  for (int spoilt = 0; spoilt < 2; spoilt++) {
    double first = spoilt ? NAN : 1.0, indefinite[] = {first, 2.0, 2.0, 1.0};
    double a[] = {first, 2.0, 2.0, 4.0}, again[] = {first, 2.0, 2.0, 4.0}, z[] = {first, 1.0, 2.0, 2.0, 2.0, 2.0, 4.0, 4.0};
    CHECK(flex_lu_factor(2, a, pivots) == 1 && flex_invert(2, again, pivots) == 1);
    CHECK(flex_complex_invert(2, z, pivots) == 1 && flex_cholesky_factor(2, indefinite) == 1);
  }
}

static const flex_tableau *const tableaus[] = {&flex_gauss_2, &flex_gauss_3, &flex_gauss_4, &flex_radau_3};

// a wrong digit in a table costs orders of convergence
TEST(tableaus_meet_the_order_conditions) {
  for (int t = 0; t < 4; t++) {
    const flex_tableau *m = tableaus[t];
    int s = m->stages;
    CHECK(m->order == (t == 3 ? 5 : 2 * s));

    // quadrature and positions of the method's order
    for (int k = 0; k < m->order; k++) {
      double rate = 0.0, position = 0.0;
      for (int i = 0; i < s; i++) rate += m->b[i] * pow(m->c[i], k), position += m->b_position[i] * pow(m->c[i], k);
      CHECK_CLOSE(rate, 1.0 / (k + 1), 1e-15);
      if (k < m->order - 1) CHECK_CLOSE(position, 1.0 / ((k + 1) * (k + 2.0)), 1e-15);
    }

    // stages integrate polynomials up to degree s - 1 once, up to s - 2 twice; the polynomial through them reaches both ends
    for (int k = 0; k < s; k++) {
      double start = 0.0, end = 0.0;
      for (int i = 0; i < s; i++) {
        double once = 0.0, twice = 0.0;
        for (int j = 0; j < s; j++) once += m->a[i][j] * pow(m->c[j], k), twice += m->a_squared[i][j] * pow(m->c[j], k);
        CHECK_CLOSE(once, pow(m->c[i], k + 1) / (k + 1), 1e-15);
        if (k < s - 1) CHECK_CLOSE(twice, pow(m->c[i], k + 2) / ((k + 1) * (k + 2.0)), 1e-15);
        start += m->at_start[i] * pow(m->c[i], k);
        end += m->at_end[i] * pow(m->c[i], k);
      }
      CHECK_CLOSE(start, k == 0, 1e-14);
      CHECK_CLOSE(end, 1.0, 1e-14);
    }
  }
}

// conditions up to order 5 for the rooted trees (Hairer, Norsett, Wanner: Solving ODEs I, table II.2.2)
static void check_order_conditions(const flex_explicit_tableau *m, const double *b, int order) {
  const int orders[] = {1, 2, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 5, 5, 5, 5, 5};
  const double densities[] = {1, 2, 3, 6, 4, 8, 12, 24, 5, 10, 15, 30, 20, 20, 40, 60, 120};
  double sums[17] = {0.0};
  for (int i = 0; i < m->stages; i++) {
    // what each node of a tree contributes: sums over a of powers of c, once, twice and three times
    double c = m->c[i], ac = 0.0, ac2 = 0.0, ac3 = 0.0, aac = 0.0, aac2 = 0.0, acac = 0.0, aaac = 0.0;
    for (int j = 0; j < i; j++) {
      double cj = m->c[j], inner = 0.0, inner2 = 0.0, inner3 = 0.0;
      for (int k = 0; k < j; k++) {
        double innermost = 0.0;
        for (int l = 0; l < k; l++) innermost += m->a[k][l] * m->c[l];
        inner += m->a[j][k] * m->c[k], inner2 += m->a[j][k] * m->c[k] * m->c[k], inner3 += m->a[j][k] * innermost;
      }
      ac += m->a[i][j] * cj, ac2 += m->a[i][j] * cj * cj, ac3 += m->a[i][j] * cj * cj * cj;
      aac += m->a[i][j] * inner, aac2 += m->a[i][j] * inner2, acac += m->a[i][j] * cj * inner, aaac += m->a[i][j] * inner3;
    }
    const double trees[17] = {1,     c,           c * c,   ac,       c * c * c, c * ac, ac2,  aac, c * c * c * c, c * c * ac,
                              c * ac2, c * aac, ac * ac, ac3, acac,     aac2,   aaac};
    for (int t = 0; t < 17; t++) sums[t] += b[i] * trees[t];
  }
  for (int t = 0; t < 17; t++)
    if (orders[t] <= order) CHECK_CLOSE(sums[t], 1.0 / densities[t], 1e-14);
}

// a wrong fraction in a published table would still integrate, only worse
TEST(explicit_tableaus_meet_the_order_conditions) {
  const flex_explicit_tableau *const explicits[] = {&flex_dormand_prince, &flex_runge_kutta_4};
  for (int t = 0; t < 2; t++) {
    const flex_explicit_tableau *m = explicits[t];
    double embedded[FLEX_MAX_EXPLICIT_STAGES];
    for (int i = 0; i < m->stages; i++) {
      double sum = 0.0;
      for (int j = 0; j < i; j++) sum += m->a[i][j];
      CHECK_CLOSE(sum, m->c[i], 1e-14);
      embedded[i] = m->b[i] - m->b_error[i];
      if (m->ends_last) CHECK(m->a[m->stages - 1][i] == m->b[i]);
    }
    check_order_conditions(m, m->b, m->order);
    if (m->is_embedded) check_order_conditions(m, embedded, m->order - 1);
  }
}

// Newton's method is solved in the eigenvectors: A and A A must come back from them
TEST(tableaus_are_diagonal_in_their_eigenvectors) {
  for (int t = 0; t < 4; t++) {
    const flex_tableau *m = tableaus[t];
    for (int i = 0; i < m->stages; i++)
      for (int j = 0; j < m->stages; j++) {
        double one = 0.0, a = 0.0, a_squared = 0.0;
        for (int k = 0; k < m->n_blocks; k++) {
          const flex_eigenvalue *z = &m->blocks[k];
          const double *l = z->left[j], *r = z->right[i], *v = z->value;
          double re = l[0] * r[0] - l[1] * r[1], im = l[0] * r[1] + l[1] * r[0];
          one += re;
          a += re * v[0] - im * v[1];
          a_squared += re * (v[0] * v[0] - v[1] * v[1]) - im * 2.0 * v[0] * v[1];
        }
        CHECK_CLOSE(one, i == j, 2e-14);
        CHECK_CLOSE(a, m->a[i][j], 2e-14);
        CHECK_CLOSE(a_squared, m->a_squared[i][j], 2e-14);
      }
  }
}

static void make_inputs(flex_inputs *inputs, double *memory) {
  flex_arena arena = {(char *)memory, 0};
  flex_inputs_take(inputs, 2, 3, &arena);
  flex_inputs_clear(inputs);
}

// the plant integrates over the polynomial that the importer has described, from whatever time it was set
TEST(inputs_are_polynomials) {
  double memory[64] = {0}, u[2], u1[2], u2[2];
  flex_inputs inputs;
  make_inputs(&inputs, memory);

  // 1 + 2 t + 3 t^2 + 4 t^3 about t = 10, and a constant
  flex_inputs_set(&inputs, 0, 10.0, 1.0);
  flex_inputs_set_derivative(&inputs, 0, 10.0, 1, 2.0);
  flex_inputs_set_derivative(&inputs, 0, 10.0, 2, 6.0);
  flex_inputs_set_derivative(&inputs, 0, 10.0, 3, 24.0);
  flex_inputs_set(&inputs, 1, 10.0, -5.0);
  flex_inputs_evaluate(&inputs, 10.0, 0.5, u);
  CHECK_CLOSE(u[0], 1.0 + 1.0 + 0.75 + 0.5, 1e-15);
  CHECK(u[1] == -5.0);
  flex_inputs_rates(&inputs, 10.5, u1, u2);
  CHECK_CLOSE(u1[0], 2.0 + 3.0 + 3.0, 1e-14);
  CHECK_CLOSE(u2[0], 6.0 + 12.0, 1e-14);
  CHECK(u1[1] == 0.0 && u2[1] == 0.0);

  // a new second derivative at t = 11: value 10, first 20, third 24 stay as they are there
  flex_inputs_set_derivative(&inputs, 0, 11.0, 2, 0.0);
  flex_inputs_evaluate(&inputs, 11.0, 2.0, u);
  CHECK_CLOSE(u[0], 10.0 + 20.0 * 2.0 + 4.0 * 8.0, 1e-12);
}

// the derivatives of a value belong to it: a new value without them is a constant
TEST(inputs_forget_derivatives_when_set) {
  double memory[64] = {0}, u[2];
  flex_inputs inputs;
  make_inputs(&inputs, memory);
  flex_inputs_set(&inputs, 0, 0.0, 1.0);
  flex_inputs_set_derivative(&inputs, 0, 0.0, 3, 6.0);
  flex_inputs_set(&inputs, 0, 1.0, 3.0);
  flex_inputs_evaluate(&inputs, 5.0, 0.0, u);
  CHECK(u[0] == 3.0);
}

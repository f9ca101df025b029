/* A fixed piece of arithmetic like that of a run: Cholesky factors of a matrix of order 12 and the square roots in it.
 * Prints the processor time [s] of the fastest of many rounds. */
#include <math.h>
#include <stdio.h>
#include <time.h>

#define N 12
#define FACTORS 1000
#define ROUNDS 100

static double now(void) {
  return (double)clock() / CLOCKS_PER_SEC;
}

// lower factor of a matrix that depends on x; its last entry
static double factor(double x) {
  double a[N][N];
  for (int i = 0; i < N; i++)
    for (int j = 0; j <= i; j++) a[i][j] = (i == j ? 2.0 * N : 0.0) + sqrt(x + i + j);
  for (int k = 0; k < N; k++) {
    a[k][k] = sqrt(a[k][k]);
    for (int i = k + 1; i < N; i++) a[i][k] /= a[k][k];
    for (int i = k + 1; i < N; i++)
      for (int j = k + 1; j <= i; j++) a[i][j] -= a[i][k] * a[j][k];
  }
  return a[N - 1][N - 1];
}

int main(void) {
  double best = HUGE_VAL, x = 1.0;
  for (int round = 0; round < ROUNDS; round++) {
    double begin = now();
    for (int i = 0; i < FACTORS; i++) x = 1.0 + 1e-3 * factor(x);
    double time = now() - begin;
    if (time < best) best = time;
  }
  if (!(x > 0.0)) return 1;
  printf("%.9g\n", best);
  return 0;
}

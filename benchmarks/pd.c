/* PD control of both joints, for the cost of a sample. */
void pd(double t, const double *u, const double *p, const double *x, double *y, double *next_x) {
  (void)t, (void)x, (void)next_x;
  for (int j = 0; j < 2; ++j) y[j] = p[0] * (u[j] - u[4 + j]) + p[1] * (u[2 + j] - u[6 + j]);
}

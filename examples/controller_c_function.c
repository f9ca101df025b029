/* PD control of both joints with a low-pass filter of the torque. It keeps nothing between calls. */
void controller_c_function(double t, const double *u, const double *p, const double *x, double *y, double *next_x) {
  const double *q_r = u, *v_r = u + 2, *q = u + 4, *v = u + 6; /* in the order of the inputs */
  const double kp = p[0], kd = p[1], pole = p[2];              /* in the order of the parameters */
  (void)t;                                                     /* instant of the sample, s */
  for (int j = 0; j < 2; ++j) {
    const double torque = kp * (q_r[j] - q[j]) + kd * (v_r[j] - v[j]);
    y[j] = pole * x[j] + (1.0 - pole) * torque;
    next_x[j] = y[j];
  }
}

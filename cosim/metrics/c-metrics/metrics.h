/* Extrema, means and crossings of a signal that is interpolated between communication points, one segment after the other:
 * the analysis of flexfmu.cosim.metrics.segments.
 *
 * A segment has the derivatives of order 0 to m - 1 at both ends, of each channel. Over theta = 0 .. 1 its polynomial has
 * the two-point form, see flexfmu.cosim.metrics.segments:
 *
 *   p(theta) = sum over k < m of (theta (1 - theta))^k ((1 - theta) alpha_k + theta beta_k)
 *
 * Nothing is allocated. Terms are alpha_0 .. alpha_(m-1), then beta_0 .. beta_(m-1), each with all channels. */
#ifndef FLEXFMU_METRICS_H
#define FLEXFMU_METRICS_H

#include <stddef.h>

#if defined(_WIN32)
#define METRICS_EXPORTED __declspec(dllexport)
#else
#define METRICS_EXPORTED __attribute__((visibility("default")))
#endif

#define METRICS_ORDERS 5
#define METRICS_CHANNELS 2
#define METRICS_POINTS 11

/* a signal, and where its analysis is written */
typedef struct {
  size_t segments, channels, orders;
  size_t left_stride, right_stride;    /* from one order of derivatives to the next */
  const double *duration;              /* [segments] */
  const double *left, *right;          /* [orders][segments][channels] */
  const double *control;               /* [2 orders][2 orders], from terms to Bernstein control points */
  const double *highest;               /* [2 orders], from terms to the derivative of order m over theta at the start */
  double *terms;                       /* [segments][2 orders][channels] */
  double *ends, *bounds, *errors;      /* [segments] largest norm at the ends, upper bound, interpolation error */
  double *jumps;                       /* [segments + 1][channels] derivative of order 2 m at the nodes, or NaN */
  size_t *kept;                        /* [segments] orders below the first that diverges; others are left out */
} metrics_signal;

/* a time derivative at the points of a quadrature */
typedef struct {
  size_t points, order;
  const double *weights;               /* [points] */
  const double *values;                /* [2 orders][points], from terms to the derivative over theta */
  const double *shape;                 /* [points] error, for a unit derivative of order 2 m over a unit step */
  const double *last;                  /* [METRICS_SAMPLES][2], from the last alpha and beta to their term's derivative */
} metrics_quadrature;

#define METRICS_SAMPLES 9

/* terms, bounds and error estimates of all segments; returns in how many an order diverges */
METRICS_EXPORTED size_t metrics_prepare(const metrics_signal *signal);

/* the largest norm, and how far it may be exceeded; after metrics_prepare */
METRICS_EXPORTED void metrics_peak(const metrics_signal *signal, double result[2]);

/* integrals over time of |v|^2, v . e and |e|^2 of a derivative v and its estimated deviation e; after metrics_prepare */
METRICS_EXPORTED void metrics_products(const metrics_signal *signal, const metrics_quadrature *quadrature,
                                       double result[3]);

/* of a signal with one channel: largest value, negated least value (both at least 0), integrals over time of its positive
 * part and of its negated negative part, estimated errors of the extremes and of each integral; after metrics_prepare */
METRICS_EXPORTED void metrics_parts(const metrics_signal *signal, double result[7]);

/* the last segment, and theta in it, at which the norm is at least the level; 0 if there is none; after metrics_prepare */
METRICS_EXPORTED int metrics_last_above(const metrics_signal *signal, double level, size_t *segment, double *theta);

#endif

"""Smoothing splines through measured positions: they pass the rows at a distance of the noise, with few knots of their own.

Source: P. Dierckx, *Curve and Surface Fitting with Splines*, Oxford 1993, chapter 5: knots are added until the sum of squared
distances is that of the noise. scipy's `splrep` is its program FITPACK.
"""

from __future__ import annotations

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import Coordinates, PiecewisePolynomial, spline

DEGREES = (3, 5)
"""Degrees of smoothing splines."""

STANDSTILL = 0.2
"""Rows of standstill before and after the motion, relative to its own rows: they make the spline begin and end at rest."""


def smoothed(
    time: RealArray, positions: RealArray, noise: float, degree: int = 5, coordinates: Coordinates = "end-effector"
) -> PiecewisePolynomial:
    """Return the smoothing spline; it begins and ends at rest at the first and the last position.

    Args:
        time: times [s], ascending from 0, shape (N,).
        positions: measured positions (N, 2).
        noise: standard deviation of their errors, in their unit.
        degree: 3 or 5; the spline is ``degree`` - 1 times continuously differentiable, next to both ends half as often.
        coordinates: what moves.

    Raises:
        TrajectoryError: the degree is another, or there is no such spline.
    """
    from scipy.interpolate import splev, splrep  # here, since other motions need no scipy

    if degree not in DEGREES:
        raise TrajectoryError(f"a smoothing spline (`noise`) has degree 3 or 5, got {degree}")
    # standstill before and after
    count, step = int(np.ceil(STANDSTILL * len(time))) + degree, float(np.median(np.diff(time)))
    still = step * np.arange(1, count + 1)
    longer = np.concatenate([-still[::-1], time, time[-1] + still])
    splines = []
    for axis in positions.T:
        values = np.concatenate([np.full(count, axis[0]), axis, np.full(count, axis[-1])])
        found, _, flag, message = splrep(
            longer, values, w=np.full(len(longer), 1.0 / noise), k=degree, s=len(time), full_output=1, quiet=1
        )
        if flag > 0:
            raise TrajectoryError(f"no smoothing spline for `noise` = {noise:g}: {message}; give another value")
        splines.append(found)
    # the same spline by its derivatives at the knots of both axes, and rest at the ends
    inner = np.unique(np.concatenate([knots for knots, _, _ in splines]))
    apart = 1e-3 * step
    knots = np.concatenate([[0.0], inner[(inner > apart) & (inner < time[-1] - apart)], time[-1:]])
    values = np.stack([[splev(knots, each, k) for k in range(degree // 2 + 1)] for each in splines], axis=-1)
    values[0, [0, -1]], values[1:, [0, -1]] = positions[[0, -1]], 0.0
    return spline(knots, values, degree, coordinates)

"""Joint references as B-splines: derivatives, ends at rest, bounds, and the motion that they become."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model.reference_design.joint_spline import (
    REST,
    JointSpline,
    basis,
    derivative_matrix,
    fitted,
    rest_matrix,
)
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.piecewise import PiecewisePolynomial

FINE = np.linspace(0.0, 1.0, 2001)


def _random(degree: int, intervals: int, duration: float = 0.3) -> JointSpline:
    free = np.random.default_rng(degree).normal(size=(intervals + degree - 2 * REST + 2, 2))
    return JointSpline(rest_matrix(intervals + degree) @ free, duration, degree)


@pytest.mark.parametrize("degree", [4, 5, 6, 7])
def test_the_trajectory_is_the_spline(degree: int) -> None:
    """Angles and derivatives up to jerk, and rest at both ends."""
    spline = _random(degree, 9)
    exact, motion = spline.evaluate(FINE, 3), spline.trajectory()
    assert isinstance(motion, PiecewisePolynomial)
    assert (motion.coordinates, motion.degree, len(motion.knots)) == ("joints", degree, 10)
    inside = slice(1, -1)
    found = motion.evaluate(FINE * spline.duration, 3)
    scale = abs(exact).max(axis=(1, 2))[:, np.newaxis, np.newaxis]
    assert abs((found - exact) / scale)[:, inside].max() < 1e-11
    assert abs(exact[1:, [0, -1]] / scale[1:]).max() < 1e-12


@pytest.mark.parametrize("order", [1, 2, 3])
def test_coefficients_bound_derivatives(order: int) -> None:
    """No value is larger than the largest coefficient, and the bound is close on smooth motions."""
    spline = _random(5, 12)
    bounds = derivative_matrix(spline.degree, spline.intervals, order) @ spline.coefficients / spline.duration**order
    assert abs(spline.evaluate(FINE, 3)[order]).max() <= abs(bounds).max() * (1 + 1e-12)
    points = np.linspace(0.1, 0.9, 7)
    slope = (basis(5, 12, points + 1e-6, order - 1) - basis(5, 12, points - 1e-6, order - 1)) / 2e-6
    assert basis(5, 12, points, order) == pytest.approx(slope, abs=1e-4 * abs(slope).max())
    assert derivative_matrix(5, 12, order) @ np.ones(17) == pytest.approx(0.0, abs=1e-9)


def test_the_fit_keeps_splines_and_ends() -> None:
    """A spline is found again; another motion keeps its ends to rounding."""
    spline = _random(5, 8)
    again = fitted(spline.trajectory(), 8)
    assert again.coefficients == pytest.approx(spline.coefficients, abs=1e-10)
    coarse = fitted(_random(7, 6).trajectory(), 20)
    assert coarse.evaluate([0.0, 1.0], 0)[0] == pytest.approx(_random(7, 6).evaluate([0.0, 1.0], 0)[0], abs=1e-14)
    assert abs(coarse.evaluate(FINE, 0) - _random(7, 6).evaluate(FINE, 0)).max() < 1e-3


def test_wrong_shapes_are_errors() -> None:
    """Too few coefficients for rest at both ends, a degree without jerk, an order above the degree."""
    with pytest.raises(TrajectoryError, match="8 or more"):
        JointSpline(np.zeros((7, 2)), 0.3)
    with pytest.raises(TrajectoryError, match="degree of 4 to 7"):
        JointSpline(np.zeros((20, 2)), 0.3, 3)
    with pytest.raises(TrajectoryError, match="up to order 5"):
        derivative_matrix(5, 8, 6)

"""Smoothing splines: measured positions give accelerations that splines through them drown in noise."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.piecewise import spline
from flexfmu.trajectories.table import smoothed

TIME = np.linspace(0.0, 0.5, 501)


def exact(time: np.ndarray, order: int) -> np.ndarray:
    """Seventh-degree polynomials from rest to rest, 1 and -2 far."""
    motion = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
    values = motion.deriv(order)(time / 0.5) / 0.5**order if order else motion(time / 0.5)
    return np.stack([values, -2.0 * values], axis=-1)


@pytest.mark.parametrize(("noise", "accuracy"), [(1e-6, 0.005), (1e-5, 0.012), (1e-4, 0.08)])
def test_acceleration_of_noisy_positions(noise: float, accuracy: float) -> None:
    """RMS of the error relative to that of the acceleration; a spline through the rows is no acceleration at all at 1e-4."""
    rows = exact(TIME, 0) + noise * np.random.default_rng(0).normal(size=(501, 2))
    motion = smoothed(TIME, rows, noise)
    instants = np.linspace(0.0, 0.5, 999)[1:-1]
    scale = np.sqrt(np.mean(exact(instants, 2) ** 2, axis=0))
    error = np.sqrt(np.mean((motion.evaluate(instants, 2)[2] - exact(instants, 2)) ** 2, axis=0)) / scale
    assert error.max() < accuracy
    through = (
        np.sqrt(np.mean((spline(TIME, rows[None]).evaluate(instants, 2)[2] - exact(instants, 2)) ** 2, axis=0)) / scale
    )
    assert through.max() > 5.0 * error.max()
    # distances are those of the noise, and the motion is much simpler than its rows
    distance = np.sqrt(np.mean((motion.evaluate(TIME, 0)[0] - rows) ** 2, axis=0))
    assert distance == pytest.approx([noise, noise], rel=0.1)
    assert len(motion.breakpoints) < 200


def test_at_rest_and_continuous() -> None:
    """Zero velocity and acceleration at the ends, at the first and last position; four continuous derivatives between."""
    rows = exact(TIME, 0) + 1e-4 * np.random.default_rng(1).normal(size=(501, 2))
    motion = smoothed(TIME, rows, 1e-4)
    np.testing.assert_array_equal(motion.evaluate([0.0], 2, "right")[:, 0], [rows[0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(motion.evaluate([0.5], 2, "left")[:, 0], [rows[-1], [0.0, 0.0], [0.0, 0.0]], atol=1e-9)
    inner = motion.knots[2:-2]
    left, right = (motion.evaluate(inner, 4, side) for side in ("left", "right"))
    for order in range(5):
        assert abs(left - right)[order].max() < 1e-8 * abs(right[order]).max()


def test_refused() -> None:
    """A degree that FITPACK doesn't have."""
    with pytest.raises(TrajectoryError, match="has degree 3 or 5, got 7"):
        smoothed(TIME, exact(TIME, 0), 1e-3, 7)

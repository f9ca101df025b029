"""Arc length and its inverse against curves whose length is known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ellipe

from flexfmu.trajectories.curves import tabulate


def ellipse_speed(a: float, b: float):
    """Speed of (a cos u, b sin u)."""
    return lambda u: np.hypot(a * np.sin(u), b * np.cos(u))


@pytest.mark.parametrize("ratio", [1.0, 1.5, 7.0, 40.0, 1e3, 1e6])
def test_quarter_ellipse(ratio: float) -> None:
    """Protects the quadrature, also where the speed varies by orders of magnitude: a complete elliptic integral."""
    table = tabulate(ellipse_speed(ratio, 1.0), 0.5 * math.pi)
    assert table.length == pytest.approx(ratio * ellipe(1.0 - ratio**-2), rel=2e-15)


@pytest.mark.parametrize("rate", [1e-3, 1.0, 3.0])
def test_inverse_is_exact(rate: float) -> None:
    """Protects Newton's method: for s = k (e^(k u) - 1) the parameter is a logarithm; 4e-15 is 9 ulp of its range."""
    table = tabulate(lambda u: rate**2 * np.exp(rate * u), 2.0)
    s = np.linspace(0.0, table.length, 10_001)
    np.testing.assert_allclose(table.parameter(s), np.log1p(s / rate) / rate, rtol=0, atol=4e-15)


def test_arc_lengths_beyond_the_ends_stay_on_the_curve() -> None:
    """Protects the ends against rounding in the arc length of a motion."""
    table = tabulate(ellipse_speed(1.0, 1.0), 1.0)
    u = table.parameter(np.array([-1e-15, 1.0 + 1e-15]))
    assert 0.0 <= u.min() <= u.max() <= 1.0
    np.testing.assert_allclose(u, [0.0, 1.0], rtol=0, atol=4e-16)

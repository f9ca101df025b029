"""Quadrature of derivatives, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from flexfmu.trajectories.trajectory import Trajectory


def assert_integrals(trajectory: Trajectory, rounding: float) -> None:
    """Every derivative to order 8 changes between the limits at an interval's ends by the integral of the next one."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for start, end in pairwise(trajectory.breakpoints):
        edges = np.linspace(start, end, 17)
        half = 0.5 * np.diff(edges)
        values = trajectory.evaluate((edges[:-1] + half * (nodes[:, None] + 1.0)).ravel(), 8)
        integrals = np.einsum("n,i,knic->kc", weights, half, values.reshape(9, 40, 16, 2))
        first, last = (trajectory.evaluate(t, 8, s)[:, 0] for t, s in ((start, "right"), (end, "left")))
        scale = np.abs(values).max(axis=(1, 2))[:, None] * (end - start)
        assert np.all(np.abs(last[:-1] - first[:-1] - integrals[1:]) <= 1e-11 * scale[1:] + rounding)


@pytest.fixture
def exact_derivatives() -> Callable[[Trajectory, float], None]:
    """See `assert_integrals`."""
    return assert_integrals

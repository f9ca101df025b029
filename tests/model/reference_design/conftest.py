"""A robot for references that follow a motion exactly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.piecewise import PiecewisePolynomial


@pytest.fixture(scope="session")
def robot() -> Scene:
    """One bending mode for each proximal link; little damping, so that nothing is forgiven."""
    few = {"effects.proximal_bending": 1, "effects.distal_axial": 0, "effects.damping.ratio": 0.01}
    return load_scene("barnard2012-6kg").replace(few)


@pytest.fixture(scope="session")
def line() -> Callable[[int, float], PiecewisePolynomial]:
    """A straight line whose first n derivatives are zero at both ends, and its duration [s]."""

    def motion(n: int, duration: float) -> PiecewisePolynomial:
        rate = np.polynomial.Polynomial([0.0, 1.0, -1.0]) ** n
        rise = (rate.integ() / rate.integ()(1.0)).coef / duration ** np.arange(2 * n + 2)
        coefficients = rise[:, np.newaxis, np.newaxis] * np.array([0.2, 0.02])
        coefficients[0] += np.array([-0.1, 0.32])
        return PiecewisePolynomial(np.array([0.0, duration]), coefficients)

    return motion

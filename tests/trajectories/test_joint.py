"""Joint trajectories: inverse kinematics with derivatives, continuous angles, and margins checked while planning."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet, RealArray, arctan2
from flexfmu.trajectories.joint import JointTrajectory, Margin
from flexfmu.trajectories.path import LameBlend, PickAndPlacePath
from flexfmu.trajectories.profiles import bang_bang, seventh_degree_polynomial
from flexfmu.trajectories.trajectory import TaskTrajectory


def task(
    start: tuple[float, float] = (-0.175, 0.320), height: float = 0.025, profile: Any = None, width: float = 0.35
) -> TaskTrajectory:
    """The paper's path with a Lamé blend, elsewhere on request."""
    path = PickAndPlacePath(start, (0.0, -1.0), height, width, LameBlend(0.025, 0.025))
    return TaskTrajectory(path, profile or seventh_degree_polynomial(), 0.43)


def test_each_derivative_is_the_integral_of_the_next(exact_derivatives: Callable[..., None]) -> None:
    """Protects every joint derivative to order 8 and both one-sided limits, by quadrature between breakpoints."""
    robot = RigidKinematics(load_scene("barnard2012-6kg").mechanism)
    exact_derivatives(JointTrajectory(task(profile=bang_bang(), height=0.03), robot), 1e-14)


@dataclass(frozen=True)
class Pointer:
    """A telescope at a base: its one angle as both joints, modulo 2π; the margin is its length."""

    base: tuple[float, float]
    required: float = 0.0

    def joints(self, x: Jet, y: Jet) -> tuple[Jet, Jet]:
        angle = arctan2(y - self.base[1], x - self.base[0])
        return angle, angle + 4.0 * math.pi

    def margins(self, position: RealArray) -> tuple[Margin, ...]:
        return (Margin("length", "m", np.hypot(*(position - self.base).T), self.required),)


@pytest.mark.parametrize("below", [0.01, 1e-3, 1e-5, 1e-8])
def test_angles_are_continuous_however_fast_they_turn(below: float) -> None:
    """Protects continuity across ±π, next to a base as well, where half a turn takes less than a sample's time."""
    motion = TaskTrajectory(
        PickAndPlacePath((-0.2, 0.0), (0.0, -1.0), 0.05, 0.4, LameBlend(0.05, 0.05)), seventh_degree_polynomial(), 1.0
    )
    trajectory = JointTrajectory(motion, Pointer((0.0, -0.05 + below)))
    start, end = trajectory.evaluate([0.0, 1.0], 0)[0]
    inner = math.atan2(0.05 - below, 0.2)
    np.testing.assert_allclose(end - start, math.pi + 2.0 * inner, rtol=1e-14)
    random = np.random.default_rng(1).permutation(np.linspace(0.0, 1.0, 501))
    shuffled = trajectory.evaluate(random, 0)[0]
    ordered = shuffled[np.argsort(random)]
    assert np.all(np.diff(ordered, axis=0) > -1e-12)  # turns one way: no jump back by 2π
    assert np.all(ordered <= end + 1e-12)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("base", [0.0, 0.01234, -0.0777])
def test_the_worst_point_is_located_exactly(base: float, side: float) -> None:
    """Protects the message: the nearest approach to a base is found to rounding, between whichever samples it lies."""
    kinematics = Pointer((base, 0.295 + 0.05 * side), required=0.06)
    with pytest.raises(TrajectoryError) as caught:
        JointTrajectory(task(), kinematics)
    message = str(caught.value)
    found = re.match(
        r"length is (\S+) m at \(x, y\) = \((\S+), (\S+)\) m, t = (\S+) s; it must be at least 0.06 m along", message
    )
    assert found, message
    value, x, y, time = map(float, found.groups())
    assert value == pytest.approx(0.05, rel=1e-5)
    assert x == pytest.approx(base, abs=2e-6)
    assert y == pytest.approx(0.295, abs=1e-6)
    position = task().evaluate(time, 0)[0, 0]
    np.testing.assert_allclose(position, [base, 0.295], rtol=0, atol=1e-5)
    assert "\n" not in message


def test_a_narrow_violation_between_samples_is_found() -> None:
    """Protects planning against margins that fall short for a moment only: 1 part in 10⁹ below what is required."""
    JointTrajectory(task(), Pointer((0.0123, 0.345), required=0.05 * (1.0 - 1e-9)))
    with pytest.raises(TrajectoryError, match=r"length is 0.05 m"):
        JointTrajectory(task(), Pointer((0.0123, 0.345), required=0.05 * (1.0 + 1e-9)))


def test_undefined_margins_are_violations_but_named_last() -> None:
    """Protects against NaN: a margin that isn't defined somewhere is violated there; a defined one tells more."""

    @dataclass(frozen=True)
    class Partial(Pointer):
        required: float = 0.1

        def margins(self, position: RealArray) -> tuple[Margin, ...]:
            (length,) = Pointer.margins(self, position)
            sine = Margin("sine", "1", np.where(length.values > 0.2, 0.5, np.nan), 0.02)
            return sine, replace(length, required=self.required)

    with pytest.raises(TrajectoryError, match=r"sine is undefined at .* at least 0.02 along"):
        JointTrajectory(task(), Partial((0.0, 0.4), required=0.0))
    with pytest.raises(TrajectoryError, match=r"length is 0.105 m at .* at least 0.2 m"):
        JointTrajectory(task(), Partial((0.0, 0.4), required=0.2))

"""Own motions as trajectories: exact between breakpoints, refused where they are none."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.sources import as_trajectory

DURATION = 0.4


class Cycloid:
    """σ of the cycloidal profile along a line of 0.2 m, and a cosine across."""

    duration: Any = DURATION

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        u = 2.0 * pi * time / DURATION
        return 0.2 * (u - sin(u)) / (2.0 * pi), 0.01 * cos(u)


class BangBang:
    """Constant acceleration, then constant deceleration."""

    duration = DURATION
    breakpoints: tuple[float, ...] = (0.2,)

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        return (time**2, 0.0) if time < 0.2 else (0.08 - (DURATION - time) ** 2, 0.0)


class Sudden(BangBang):
    """Deceleration that begins where no interval ends by halving."""

    breakpoints = (0.13,)

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        rest, speed = DURATION - time, 2.0 * 0.13
        if time < 0.13:
            return time**2, 0.0
        return 0.13**2 + 0.5 * speed * (DURATION - 0.13) - 0.5 * speed * rest**2 / (DURATION - 0.13), 0.0


def changed(base: type, **members: Any) -> Any:
    """An instance of the class with other members."""
    return type(base.__name__, (base,), members)()


def test_polynomials_have_the_derivatives_of_the_formula() -> None:
    """Acceleration to 1e-9 and the fourth derivative to 1e-5 of their largest values, at both ends too."""
    motion = as_trajectory(Cycloid())
    time = np.linspace(0.0, DURATION, 401)[1:-1]
    w = 2.0 * pi / DURATION
    u = w * time
    exact = np.array(
        [
            [0.2 * (u - np.sin(u)) / (2.0 * pi), 0.01 * np.cos(u)],
            [0.2 / DURATION * (1.0 - np.cos(u)), -0.01 * w * np.sin(u)],
            [0.2 / DURATION * w * np.sin(u), -0.01 * w**2 * np.cos(u)],
            [0.2 / DURATION * w**2 * np.cos(u), 0.01 * w**3 * np.sin(u)],
            [-0.2 / DURATION * w**3 * np.sin(u), 0.01 * w**4 * np.cos(u)],
        ]
    ).swapaxes(1, 2)
    found = motion.evaluate(time, 12)
    for order, tolerance in enumerate((1e-13, 1e-12, 1e-9, 1e-7, 1e-5)):
        largest = abs(exact[order]).max()
        np.testing.assert_allclose(found[order], exact[order], rtol=0, atol=tolerance * largest)
    np.testing.assert_array_equal(found[11:], 0.0)


@pytest.mark.parametrize("extent", [0.0, 1e-9, 1e-6, 1e-3])
def test_small_motions_and_standstills(extent: float) -> None:
    """Positions to rounding, and accelerations as exact as rounded positions give them by Markov's inequality, n²(n² - 1)/3 / (half an
    interval)²; a standstill has none."""

    class Small(Cycloid):
        def position(self, time: float) -> tuple[float, float]:
            x, y = super().position(time)
            return -0.1 + extent * x, 0.3 + extent * y

    motion, large = as_trajectory(Small()), as_trajectory(Cycloid())
    time = np.linspace(0.0, DURATION, 101)
    found, exact = motion.evaluate(time, 2), extent * large.evaluate(time, 2)
    exact[0] += -0.1, 0.3
    np.testing.assert_allclose(found[0], exact[0], rtol=0, atol=1e-15)
    if extent:
        rounding = 2.0 * np.finfo(float).eps * 0.3 * 100.0 * 33.0 / (0.5 * np.diff(motion.breakpoints).min()) ** 2
        np.testing.assert_allclose(found[2], exact[2], rtol=0, atol=rounding)
    else:
        np.testing.assert_array_equal(found[1:], 0.0)


def test_breakpoints_have_two_limits() -> None:
    """The acceleration jumps where the class says, and only there."""
    motion = as_trajectory(BangBang())
    assert motion.breakpoints == (0.0, 0.2, DURATION)
    sides = [motion.evaluate(0.2, 2, side)[:, 0, 0] for side in ("left", "right")]  # type: ignore[arg-type]
    np.testing.assert_allclose(sides, [[0.04, 0.4, 2.0], [0.04, 0.4, -2.0]], rtol=1e-9)
    assert 0.13 in as_trajectory(Sudden()).breakpoints
    assert as_trajectory(changed(Cycloid, duration=lambda self: DURATION)).duration == DURATION  # a method does too


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        (Cycloid, r"an own motion is an object of its class: give Cycloid\(\) in place of Cycloid"),
        (object(), "object has no `duration`: an own motion needs `duration`"),
        (changed(Cycloid, duration=0.0), "duration of the own motion must be above zero and finite, got 0 s"),
        (changed(Cycloid, position=lambda self, time: 1.0), r"position\(0\) must return two numbers, got 1\.0"),
        (changed(Cycloid, position=lambda self, time: (np.nan, 0.0)), r"position\(0\) must return two finite numbers"),
        (changed(Cycloid, position=lambda self, time: (time, 0.0)), r"velocity of the own motion jumps by 1 per second at 0(\.4)? s"),
        (changed(Sudden, breakpoints=()), r"isn't smooth near 0\.13\d* s: add this instant to its `breakpoints`"),
    ],
)  # fmt: skip
def test_what_is_no_motion_is_refused(motion: Any, message: str) -> None:
    """What is wrong, where, and what to do."""
    with pytest.raises(TrajectoryError, match=message):
        as_trajectory(motion)

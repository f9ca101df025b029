"""What series, paths, profiles, motions and shapers refuse: one line with value, limit, unit and remedy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import ruckig
from scipy.interpolate import CubicSpline

from flexfmu.trajectories.curves import tabulate
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet, power, sqrt
from flexfmu.trajectories.path import ClothoidPair, LameBlend, PickAndPlacePath, PolarPolynomial
from flexfmu.trajectories.piecewise import spline
from flexfmu.trajectories.profiles import double_s, evaluate_profile, polynomial, seventh_degree_polynomial, trapezoidal
from flexfmu.trajectories.shapers.designs import design, extra_insensitive, specified_insensitivity, zero_vibration
from flexfmu.trajectories.shapers.sequence import UNSHAPED, ImpulseSequence, Oscillator
from flexfmu.trajectories.sources import from_ruckig, from_scipy, from_toppra
from flexfmu.trajectories.table import smoothed
from flexfmu.trajectories.trajectory import TaskTrajectory

NONE = (0.0, -0.025, math.nan, math.inf)
"""Numbers that are no lengths, durations or frequencies."""

MODE = Oscillator(10.0)


def path(**changed: Any) -> PickAndPlacePath:
    """A path with Lamé blends, changed."""
    given: dict[str, Any] = {"start": (0.0, 0.0), "lift": (0.0, 1.0), "height": 0.025, "width": 0.35}
    return PickAndPlacePath(**(given | {"blend": LameBlend(0.025, 0.025)} | changed))


def motion(duration: float = 0.43) -> TaskTrajectory:
    """A motion along it."""
    return TaskTrajectory(path(), seventh_degree_polynomial(), duration)


REFUSED: list[tuple[Callable[[], Any], str]] = [
    # series
    (lambda: sqrt(Jet.variable([1.0, 0.0], 1)), "square root .* above zero, got 0.0 at index 1"),
    (lambda: sqrt(Jet.constant(math.nan, 0)), "square root .* got nan"),
    (lambda: power(Jet.variable(0.0, 1), 0.5), "real power .* above zero"),
    (lambda: 1.0 / Jet.variable([[1.0, 2.0], [0.0, 1.0]], 1), "division .* other than zero, got 0.0 at index 1, 0"),
    (lambda: Jet.constant(0.0, 1.5), "whole number of at least 0, got 1.5"),  # type: ignore[arg-type]
    (lambda: Jet.constant(0.0, 0).differentiate(), "order 0 has no derivative"),
    (lambda: Jet(np.zeros((0, 2))), "at least one coefficient"),
    # blends and paths
    *((lambda k=kind, x=bad: k(x, 0.025), f"blend height d must be above zero and finite, got {bad:g} m") for kind in (LameBlend, ClothoidPair, PolarPolynomial) for bad in NONE),
    *((lambda k=kind, x=bad: k(0.025, x), f"blend width e must be above zero and finite, got {bad:g} m") for kind in (LameBlend, ClothoidPair, PolarPolynomial) for bad in NONE),
    *(
        (
            lambda x=ratio: ClothoidPair(0.025, 0.025 * x),
            rf"needs 0\.5621 < e/d < 1\.7790, got e/d = {ratio:.6g} \(e = {0.025 * ratio:g} m, d = 0\.025 m\); "
            r"for d = 0\.025 m choose e between 0\.0140525 m and 0\.044475 m",
        )
        for ratio in (0.1, 0.5620, 1.7791, 5.0)
    ),
    *((lambda x=s: LameBlend(0.025, 0.025).curve.jets([0.0, x]), r"arc length must be between 0 and 0.0421562\d+ m, got .* at index 1") for s in (-1e-9, 0.05, math.nan)),
    (lambda: LameBlend(0.025, 0.025).curve.jets(0.0, -1), "order"),
    (lambda: tabulate(lambda u: 2.0 + np.sin(1e9 * u), 1.0), "too elongated"),
    (lambda: path(height=0.02), r"blend height d = 0.025 m must be at most the path's height, 0.02 m; .* overlap"),
    (lambda: path(width=0.04), r"blend width e = 0.025 m must be at most half the path's width, 0.02 m; .* overlap"),
    (lambda: path(height=-0.025), "path height must be above zero and finite, got -0.025 m"),
    (lambda: path(width=0.0), "path width must be above zero and finite, got 0 m"),
    (lambda: path(width=math.nan), "path width must be above zero and finite, got nan m"),
    (lambda: path(lift=(0.0, 0.0)), r"path lift must be a direction other than \(0, 0\)"),
    (lambda: path(lift=(0.0, math.nan)), "path lift must be two finite numbers"),
    (lambda: path(start=(math.inf, 0.0)), r"path start must be two finite numbers \[m\], got \(inf, 0.0\)"),
    (lambda: path(start=(1.0, 2.0, 3.0)), "path start must be two finite numbers"),
    # profiles
    *((lambda x=ramp: trapezoidal(x), f"ramp must be above 0 and at most 0.5 of the duration, got {ramp:g}") for ramp in (0.0, -0.1, 0.5000001, math.nan, math.inf)),
    *((lambda x=eta: evaluate_profile(trapezoidal(0.5), x), "fraction of the duration must be between 0 and 1") for eta in (-1e-9, 1.1, math.nan)),
    (lambda: double_s(0.6, 0.1), "ramp must be above 0 and at most 0.5"),
    (lambda: double_s(0.3, 0.0), "jerk_phase must be above 0 and at most 0.25"),
    (lambda: double_s(0.2, 0.11), "jerk_phase must be at most half of ramp = 0.2, which is 0.1 of the duration, got 0.11"),
    (lambda: polynomial((0, 0)), "must begin at rest: its first two coefficients must be 0"),
    (lambda: polynomial((0, 1, 0)), "must begin at rest: its first two coefficients must be 0"),
    (lambda: polynomial((0, 0, 3, -2.1)), r"must end at 1: its coefficients must have the sum 1, got 0\.9"),
    (lambda: polynomial((0, 0, 1)), r"must end at rest: the sum of k c_k must be 0, got 2"),
    (lambda: polynomial((0, 0, math.nan)), "must have finite coefficients"),
    (lambda: polynomial((0, 0, 27, -86, 96, -36)), r"stops or goes backwards at 0\.5 of the duration"),
    (lambda: polynomial((0, 0, -3, 10, -6)), r"stops or goes backwards at 0 of the duration"),
    (lambda: polynomial((0, 0, 12, -20, 9)), r"stops or goes backwards at 1 of the duration"),
    # motions
    *((lambda x=bad: motion(x), f"trajectory duration must be above zero and finite, got {bad:g} s") for bad in NONE),
    (lambda: motion().evaluate([0.0, math.nan]), "times must be finite, got nan s at index 1"),
    (lambda: motion().evaluate(math.inf), "times must be finite, got inf s at index 0"),
    (lambda: motion().evaluate([[0.0]]), r"shape \(N,\), got shape \(1, 1\)"),
    (lambda: motion().evaluate(0.0, -1), "order of a derivative must be a whole number of at least 0, got -1"),
    (lambda: motion().evaluate(0.0, 1.5), "whole number .* got 1.5"),  # type: ignore[arg-type]
    (lambda: motion().evaluate(0.0, 2, "both"), 'side must be "left" or "right", got \'both\''),  # type: ignore[arg-type]
    # splines, and motions of other libraries
    (lambda: spline([0.0, 1.0], np.zeros((1, 2, 2)), 4), "need a spline of degree 3 or 5 or 7, got 4"),
    (lambda: spline([0.0, 1.0], np.zeros((3, 2, 2)), 3), "need a spline of degree 5 or 7, got 3"),
    (lambda: spline([0.0, 1.0], np.zeros((1, 3, 2)), 5), r"shape \(m \+ 1, 2, 2\)"),
    (lambda: spline([0.0], np.zeros((1, 1, 2)), 5), "2 or more times"),
    (lambda: spline([1.0, 0.0], np.zeros((1, 2, 2)), 5), "must ascend from 0 s"),
    (lambda: smoothed(np.linspace(0.0, 1.0, 9), np.zeros((9, 2)), 1e-3, 7), "has degree 3 or 5, got 7"),
    (lambda: from_ruckig("motion"), "expected a ruckig.Trajectory, got str"),
    (lambda: from_ruckig(ruckig.Trajectory(3)), "has 3 coordinates, the robot's motions have 2"),
    (lambda: from_ruckig(ruckig.Trajectory(2)), "calculate it first"),
    (lambda: from_toppra(None), "toppra found no trajectory"),
    (lambda: from_toppra(1.0), "expected what toppra's compute_trajectory returns, got float"),
    (lambda: from_scipy(np.zeros(3)), "expected a PPoly, CubicSpline or BSpline of vectors, got ndarray"),
    (lambda: from_scipy(CubicSpline([0, 1, 2], np.zeros((3, 3)))), "has 3 coordinates"),
    (lambda: from_scipy(CubicSpline([0, 1, 2], np.zeros(3))), "of vectors, got CubicSpline"),
    # modes and shapers
    *((lambda x=bad: Oscillator(x), r"natural frequency must be above zero.* Hz") for bad in NONE),
    *((lambda x=bad: Oscillator(1.0, x), "damping ratio must be at least 0 and below 1") for bad in (-1e-9, 1.0, math.nan, math.inf)),
    *((lambda x=bad: UNSHAPED.residual(1.0, x), "damping ratio") for bad in (-1e-9, 1.0, math.nan, math.inf)),
    *((lambda f=function, x=bad: f(x), "must be above 0 and below 1") for bad in (*NONE, 1.0) for function in (
        lambda tolerance: extra_insensitive(MODE, tolerance),
        lambda tolerance: specified_insensitivity(0.9, 1.1, tolerance),
    )),
    (lambda: ImpulseSequence((), ()), "at least one; got 0 and 0"),
    (lambda: ImpulseSequence((0.0, 0.1), (1.0,)), "got 2 and 1"),
    (lambda: ImpulseSequence((0.1, 0.2), (0.5, 0.5)), "start at 0 and ascend, got 0.1, 0.2 s"),
    (lambda: ImpulseSequence((0.0, 0.2, 0.2), (0.5, 0.25, 0.25)), "start at 0 and ascend"),
    (lambda: ImpulseSequence((0.0, 0.2), (0.5, 0.4)), "add up to 0.9"),
    (lambda: ImpulseSequence((0.0, math.nan), (0.5, 0.5)), "finite numbers"),
    (lambda: ImpulseSequence((0.0, 0.1), (math.inf, 0.5)), "finite numbers"),
    (lambda: zero_vibration(MODE, -1), r"0 to 20, got -1"),
    (lambda: extra_insensitive(MODE, humps=0), r"humps must be 1 to 8, got 0"),
    (lambda: specified_insensitivity(12.0, 10.0), r"at least the lowest, 12 Hz, got 10 Hz"),
    (lambda: specified_insensitivity(1.0, 100.0), "choose a narrower range"),
    (lambda: zero_vibration(MODE).split(0.0), r"sample time must be above zero.* s"),
    (lambda: zero_vibration(MODE).residual([1.0, -1.0]), r"frequencies must be .* at index 1"),
    (lambda: design("zzz", [MODE]), "shaper must be one of"),
    (lambda: design("zv", []), "at least one vibration mode"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "said"), REFUSED)
def test_refused(make: Callable[[], Any], said: str) -> None:
    """No NaN travels on, and the message is one line."""
    with pytest.raises(TrajectoryError, match=said) as caught:
        make()
    assert "\n" not in str(caught.value)

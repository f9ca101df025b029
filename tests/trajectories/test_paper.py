"""Tables of Barnard, Briot, Caro, *Trajectory generation for high speed pick-and-place robots*, ESDA 2012.

Where the paper's figure can't be right the test states the value that the paper's own definitions give.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexfmu.trajectories.blends import Blend, ClothoidPair, LameBlend, PolarPolynomial
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.profiles import bang_bang, seventh_degree_polynomial, trapezoidal
from flexfmu.trajectories.trajectory import TaskTrajectory

PROFILES = {
    "poly7": seventh_degree_polynomial(),
    "bang-bang": bang_bang(),
    "1/4 trapezoidal": trapezoidal(1 / 4),
    "1/8 trapezoidal": trapezoidal(1 / 8),
}
BLENDS = {
    "lame": LameBlend(0.025, 0.025),
    "clothoid": ClothoidPair(0.025, 0.025),
    "polar": PolarPolynomial(0.025, 0.025),
}

# Table 5, task space [m/s²], and Table 6, joint space [rad/s²]; rows are profiles, columns blends
TASK_ACCELERATION = {
    ("poly7", "lame"): 7.7818,
    ("bang-bang", "lame"): 5.1687,
    ("1/4 trapezoidal", "lame"): 6.8895,
    ("1/8 trapezoidal", "lame"): 11.8115,
    ("poly7", "polar"): 7.0384,
    ("bang-bang", "polar"): 4.4662,
    ("1/4 trapezoidal", "polar"): 5.9544,
    ("1/8 trapezoidal", "polar"): 10.0453,
}
JOINT_ACCELERATION = {
    ("poly7", "lame"): 25.0858,
    ("bang-bang", "lame"): 16.4343,
    ("1/4 trapezoidal", "lame"): 21.8879,
    ("1/8 trapezoidal", "lame"): 37.432,
    ("poly7", "clothoid"): 25.3279,
    ("bang-bang", "clothoid"): 16.4834,
    ("1/4 trapezoidal", "clothoid"): 21.9759,
    ("1/8 trapezoidal", "clothoid"): 37.6681,
    ("poly7", "polar"): 21.2023,
    ("bang-bang", "polar"): 13.7179,
    ("1/4 trapezoidal", "polar"): 18.1215,
    ("1/8 trapezoidal", "polar"): 30.9457,
}


def path(blend: Blend) -> PickAndPlacePath:
    """The path of all tables: lifted towards the bases."""
    return PickAndPlacePath((-0.175, 0.320), (0.0, -1.0), 0.025, 0.350, blend)


def both_sides(trajectory: TaskTrajectory | JointTrajectory, points: int = 4001) -> RealArray:
    """Second derivatives at many times and on both sides of every breakpoint, shape (N, 2)."""
    times = np.union1d(np.linspace(0.0, trajectory.duration, points), trajectory.breakpoints)
    return np.concatenate([trajectory.evaluate(times, 2, side)[2] for side in ("left", "right")])


@pytest.mark.parametrize(
    ("blend", "millimetres", "digits"),
    [
        (LameBlend(0.025, 0.025), 42.1562, 4),
        (PolarPolynomial(0.025, 0.025), 41.1064, 4),
        (ClothoidPair(0.025, 0.025), 41.998, 3),  # the printed 41.333 isn't the symmetric pair's length
        (LameBlend(0.025, 0.0445), 59.307, 3),  # "extended" is e = 44.5 mm
    ],
)
def test_table_2_blend_lengths(blend: Blend, millimetres: float, digits: int) -> None:
    """Protects the geometry of the blends, to every printed digit."""
    assert round(1e3 * blend.curve.length, digits) == millimetres


@pytest.mark.parametrize(("profile", "blend"), TASK_ACCELERATION)
def test_table_5_accelerations_in_task_space(profile: str, blend: str) -> None:
    """Protects path and profile together: the largest acceleration for a duration of 1 s."""
    found = np.hypot(*both_sides(TaskTrajectory(path(BLENDS[blend]), PROFILES[profile], 1.0)).T).max()
    tolerance = 0.011 if (profile, blend) == ("1/8 trapezoidal", "polar") else 1e-3
    assert found == pytest.approx(TASK_ACCELERATION[profile, blend], rel=tolerance)


@pytest.mark.parametrize(("profile", "blend"), JOINT_ACCELERATION)
def test_table_6_accelerations_in_joint_space(profile: str, blend: str, five_bar: Any) -> None:
    """Protects inverse kinematics with derivatives: the largest signed acceleration of the first joint."""
    found = both_sides(JointTrajectory(TaskTrajectory(path(BLENDS[blend]), PROFILES[profile], 1.0), five_bar))[
        :, 0
    ].max()
    tolerance = {"lame": 0.005, "clothoid": 0.015, "polar": 0.024}[blend]
    assert found == pytest.approx(JOINT_ACCELERATION[profile, blend], rel=tolerance)


@pytest.mark.parametrize(
    ("blend", "metres"),
    [
        (LameBlend(0.025, 0.025), 0.3843),
        (ClothoidPair(0.025, 0.025), 0.3840),
        (LameBlend(0.025, 0.175), 0.3687),  # "Lamé Ext": no straight part is left
    ],
)
def test_table_11_path_lengths(blend: Blend, metres: float) -> None:
    """Protects the path's length, which scales every acceleration, to every printed digit."""
    assert round(path(blend).length, 4) == metres

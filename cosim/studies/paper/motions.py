"""The comparisons that need no simulation: lengths of curves, largest accelerations, natural frequencies along the path."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.studies.paper.comparison import EvaluateCell
from flexfmu.cosim.studies.paper.simulations import case_scene, profiles, trajectory_scene
from flexfmu.model.modes import natural_frequencies
from flexfmu.trajectories.trajectory import Trajectory

POINTS = 2001
"""Instants between two breakpoints: a smooth maximum is met to about (pi / POINTS)²/8 < 1e-6 relative."""


def motion_evaluators() -> Mapping[str, EvaluateCell]:
    """Metric → function of row and column, for the metrics that need no simulation."""
    return {
        "blend_length": lambda row, column: blend_length(row),
        "path_length": lambda row, column: path_length(column),
        "peak_task_acceleration": peak_task_acceleration,
        "peak_joint_acceleration_1": peak_joint_acceleration,
    }


def blend_length(curve: str) -> float:
    """Arc length of one blend [m]."""
    return plan(trajectory_scene(_any_profile(), curve)).along_path.path.blend.curve.length


def path_length(curve: str) -> float:
    """Arc length of the whole path [m]."""
    return plan(trajectory_scene(_any_profile(), curve)).along_path.path.length


def peak_task_acceleration(profile: str, curve: str) -> float:
    """Largest norm of the end effector's acceleration [m/s²], both sides of every jump included."""
    task = plan(trajectory_scene(profile, curve)).task
    return maximum(task, lambda derivatives: np.hypot(derivatives[2, :, 0], derivatives[2, :, 1]))


def peak_joint_acceleration(profile: str, curve: str) -> float:
    """Largest signed second derivative of q11 [rad/s²]."""
    joints = plan(trajectory_scene(profile, curve)).joints
    return maximum(joints, lambda derivatives: derivatives[2, :, 0])


def maximum(trajectory: Trajectory, quantity: Callable[[RealArray], RealArray]) -> float:
    """Largest value of a quantity over the motion.

    Args:
        trajectory: the motion.
        quantity: function of the trajectory's derivatives (order + 1, N, 2) with a result of shape (N,).
    """
    return max(float(np.max(quantity(derivatives))) for _, derivatives in smooth_pieces(trajectory, POINTS))


def smooth_pieces(trajectory: Trajectory, points: int, order: int = 2) -> Iterator[tuple[RealArray, RealArray]]:
    """Times (N,) and derivatives (order + 1, N, 2) between neighbouring breakpoints, with one-sided limits at both."""
    for begin, end in pairwise(trajectory.breakpoints):
        time = np.linspace(begin, end, points)
        before = trajectory.evaluate(time[:-1], order=order, side="right")
        last = trajectory.evaluate(time[-1:], order=order, side="left")
        yield time, np.concatenate([before, last], axis=1)


def _any_profile() -> str:
    """A path doesn't depend on the motion profile."""
    return next(iter(profiles()))


POSES = 41
"""Poses along the path, start, middle and end included."""

ROWS: Mapping[str, tuple[str, int]] = {
    "first, 6 kg": ("barnard2012-6kg", 0),
    "first, 0.1 kg": ("barnard2012-0.1kg", 0),
    "third, 0.1 kg": ("barnard2012-0.1kg", 2),
}
"""Row of the comparison → scene, and index of the frequency in ascending order."""


def frequencies_along_path(scene_name: str) -> NDArray[np.float64]:
    """Natural frequencies [Hz], ascending, at `POSES` poses of the Lamé path, (poses, n)."""
    scene = case_scene(scene_name, "7th order polynomial", "Lamé")
    joints = plan(scene).joints
    poses = joints.evaluate(np.linspace(0.0, joints.duration, POSES), order=0)[0]
    return np.stack([natural_frequencies(scene, pose) for pose in poses])


def frequency_evaluators() -> Mapping[str, EvaluateCell]:
    """The metric of the frequencies' comparison → function of row and column."""
    frequencies = {name: frequencies_along_path(name) for name, _ in ROWS.values()}

    def evaluate(row: str, column: str) -> float:
        name, index = ROWS[row]
        lowest, highest = frequencies[name][:, index].min(), frequencies[name][:, index].max()
        return float({"centre": highest + lowest, "half range": highest - lowest}[column] / 2)

    return {"natural_frequency": evaluate}

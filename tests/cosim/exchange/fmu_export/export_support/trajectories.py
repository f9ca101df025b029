"""Trajectories to export: with closed form, and the robot's own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.path import Blend, LameBlend, PickAndPlacePath
from flexfmu.trajectories.profiles import Profile
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Swing:
    """sin(ω t) from a corner to a corner: all derivatives jump at the start, at ``kink`` (where it turns back on request)
    and at the end.

    Attributes:
        frequency: ω [rad/s].
        duration: [s].
        kink: where the sign of the velocity jumps [s].
        names_kink: whether the kink is among the breakpoints, as it should be.
    """

    frequency: float = 9.0
    duration: float = 1.0
    kink: float = 0.4
    names_kink: bool = True

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return (0.0, self.kink, self.duration) if self.names_kink else (0.0, self.duration)

    def evaluate(self, time: ArrayLike, order: int = 2, side: str = "right") -> Array:
        t = np.atleast_1d(np.asarray(time, dtype=np.float64))
        after = t >= self.kink if side == "right" else t > self.kink
        phase = self.frequency * np.where(after, 2.0 * self.kink - t, t)
        sign = np.where(after, -1.0, 1.0)
        rows = [(sign * self.frequency) ** k * np.sin(phase + 0.5 * np.pi * k) for k in range(order + 1)]
        before = t < 0.0 if side == "right" else t <= 0.0
        done = t >= self.duration if side == "right" else t > self.duration
        end = np.sin(self.frequency * (2.0 * self.kink - self.duration))
        result = np.array(rows)
        result[:, before | done] = 0.0
        result[0, done] = end
        return result[:, :, None]


def robot(blend: type[Blend], profile: Profile) -> Trajectory:
    """Joint motion of the paper's scene with another blend and profile."""
    scene = load_scene("barnard2012-6kg")
    section = scene.trajectory
    shape = blend(section.blend.height, section.blend.width)  # type: ignore[call-arg]
    path = PickAndPlacePath(section.start, section.lift, section.height, section.width, shape)
    return JointTrajectory(TaskTrajectory(path, profile, section.duration), RigidKinematics(scene.mechanism))


def lame(profile: Profile) -> Trajectory:
    """With the paper's own blend."""
    return robot(LameBlend, profile)

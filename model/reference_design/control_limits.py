"""What optimal control keeps to: robots with their torques, limits of the joints' references, the area of the end effector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi
import numpy as np

from flexfmu.model.reference_design.joint_spline import JointSpline
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray

MESH = 1 / 40
"""Distance between points at which distances are tabulated, relative to the area's shorter side."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot that the motion shall suit.

    Attributes:
        scene: the robot with its payload.
        torque: largest magnitudes of the motor torques [N m], (2,).
        residual: largest residual vibration [m].
    """

    scene: Scene
    torque: RealArray
    residual: float = 1e-6


@dataclass(frozen=True)
class ReferenceLimits:
    """Largest magnitudes of the joints' speed [rad/s], acceleration [rad/s²] and jerk [rad/s³]."""

    speed: float
    acceleration: float
    jerk: float

    @property
    def values(self) -> tuple[float, float, float]:
        """All three."""
        return self.speed, self.acceleration, self.jerk

    def used(self, spline: JointSpline) -> list[float]:
        """Largest values of a motion, relative to the limits."""
        moving = spline.evaluate(np.linspace(0.0, 1.0, 100 * spline.intervals + 1), 3)[1:]
        return [float(abs(each).max() / limit) for each, limit in zip(moving, self.values, strict=True)]

    def divided(self, shares: Sequence[float]) -> ReferenceLimits:
        """Limits divided by factors."""
        return ReferenceLimits(*(limit / share for limit, share in zip(self.values, shares, strict=True)))


@dataclass(frozen=True, eq=False)
class Area:
    """Where the end effector may go: a rectangle in a frame, less regions.

    Attributes:
        origin: of the frame [m], (2,).
        axes: unit vectors of the frame's coordinates, in rows (2, 2).
        low, high: corners of the rectangle in the frame [m], (2,).
        distances: of points (N, 2) [m] from each region, (N,) [m], negative inside.
        margin: depth by which the end effector may enter a region [m].
    """

    origin: RealArray
    axes: RealArray
    low: RealArray
    high: RealArray
    distances: tuple[Callable[[RealArray], RealArray], ...] = ()
    margin: float = 1e-4

    @property
    def scale(self) -> float:
        """The rectangle's shorter side [m]."""
        return float(min(self.high - self.low))

    @cached_property
    def smooth(self) -> tuple[casadi.Function, ...]:
        """A cubic spline through each region's distances: point in the frame / scale → distance / scale."""
        return tuple(self._smooth(distance) for distance in self.distances)

    def _smooth(self, distance: Callable[[RealArray], RealArray]) -> casadi.Function:
        step = MESH * self.scale
        axes = [
            np.linspace(low - 3 * step, high + 3 * step, 7 + int((high - low) / step))
            for low, high in zip(self.low, self.high, strict=True)
        ]
        mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        values = distance(self.origin + mesh @ self.axes).reshape([len(axis) for axis in axes])
        table = casadi.interpolant("table", "bspline", [axis.tolist() for axis in axes], values.ravel(order="F"))
        point = casadi.MX.sym("point", 2)
        return casadi.Function("distance", [point], [table(self.scale * point) / self.scale])

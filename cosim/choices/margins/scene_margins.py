"""Margins of a scene's loop at poses along its path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from math import isnan, nan
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.choices.effects.choice import resolved
from flexfmu.cosim.choices.margins.linear_loop import LinearLoop
from flexfmu.cosim.choices.margins.margins import LoopMargins, PoseMargins, pose_margins
from flexfmu.cosim.choices.margins.scene_loop import WiredLoop
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.along_path import positions_along

if TYPE_CHECKING:
    import pandas

POSES = 5
"""Usual number of poses."""

BETTER_IF_LESS = ("gain_reduction", "sensitivity_peak")
"""Margins that are worse the larger they are."""


@dataclass(frozen=True, eq=False)
class MarginsResult:
    """Margins of a loop along a path.

    Attributes:
        scene: the scene.
        poses: margins at each pose, from start to end.
        linear: the linear loop at each pose.
    """

    scene: Scene
    poses: tuple[PoseMargins, ...]
    linear: tuple[LinearLoop, ...]

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable at all poses."""
        return all(pose.is_stable for pose in self.poses)

    @property
    def worst(self) -> LoopMargins:
        """The worst value of each margin over all poses and all cuts."""
        rows = [row for pose in self.poses for row in pose.loops]
        found: dict[str, Any] = {"channel": "worst"}
        for name in (field.name for field in fields(LoopMargins) if field.name != "channel"):
            values = [value for row in rows if not isnan(value := getattr(row, name))]
            found[name] = (max if name in BETTER_IF_LESS else min)(values, default=nan)
        return LoopMargins(**found)

    def rows(self) -> list[dict[str, Any]]:
        """A row for each pose and each cut, in SI units."""
        names = [field.name for field in fields(LoopMargins)]
        return [
            {"s": pose.s, "x": pose.position[0], "y": pose.position[1], "stable": pose.is_stable, "radius": pose.radius}
            | {name: getattr(row, name) for name in names}
            for pose in self.poses
            for row in pose.loops
        ]

    def to_pandas(self) -> pandas.DataFrame:
        """The rows as a data frame.

        Raises:
            InputError: pandas isn't installed.
        """
        try:
            import pandas
        except ImportError:
            raise InputError('data frames need pandas: pip install "flexfmu[pandas]"') from None
        return pandas.DataFrame(self.rows())


def scene_margins(
    scene: Scene, *, poses: int = POSES, progress: Callable[[float], None] = lambda fraction: None
) -> MarginsResult:
    """The margins of a scene's loop at equilibria along its path.

    Args:
        scene: the scene, driven by torques, with controllers.
        poses: number of poses, equally spaced along the path; 1 for its end.
        progress: called with the finished fraction, 0 to 1.

    Raises:
        InputError: the scene has no loop, a slave can't be linearised, or sample times have no common period.
        TrajectoryError: the motion isn't feasible.
        EquilibriumError: there is no equilibrium at a pose.
    """
    if poses < 1:
        raise InputError(f"the number of poses must be at least 1, got {poses}")
    scene = resolved(scene)
    loop = loop_of(scene, about_rest=True)
    wired = WiredLoop(scene, loop)
    once = loop.motion.once
    found, loops = [], []
    for s in np.linspace(0.0, 1.0, poses).tolist() if poses > 1 else [1.0]:
        x, y = positions_along(once.along_path, s)[0].tolist()
        linear, names = wired.at((x, y))
        found.append(pose_margins(linear, names, s, (x, y), _joints(scene, (x, y))))
        loops.append(linear)
        progress(len(found) / poses)
    return MarginsResult(scene, tuple(found), tuple(loops))


def _joints(scene: Scene, position: tuple[float, float]) -> tuple[float, float]:
    first, second = motor_angles(scene.mechanism, position)
    return float(first), float(second)

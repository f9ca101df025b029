"""Margins of a scene's loop at poses along its path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from math import isnan, nan
from typing import Any

import numpy as np

from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.margins.course import PathLoop, Place, least_places, worst_places
from flexfmu.cosim.design.margins.linear_loop import LinearLoop
from flexfmu.cosim.design.margins.loop_warnings import coarse_counts
from flexfmu.cosim.design.margins.margins import LoopMargins, PoseMargins, pose_margins
from flexfmu.cosim.design.margins.scene_loop import WiredLoop
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.reports.rows import Rows
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.schema import Scene

POSES = 5
"""Usual number of poses."""

BETTER_IF_LESS = ("gain_reduction", "sensitivity_peak")
"""Margins that are worse the larger they are."""


@dataclass(frozen=True, eq=False)
class MarginsResult(Rows):
    """Margins of a loop along a path.

    Attributes:
        scene: the scene.
        poses: margins at the poses that were asked for and at the worst ones, from start to end, then with other payloads.
        linear: the linear loop at each pose.
        coarse_counts: what there is to say of encoders that are too coarse for the gains; None for fine ones.
    """

    scene: Scene
    poses: tuple[PoseMargins, ...]
    linear: tuple[LinearLoop, ...]
    coarse_counts: str | None = None

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable at all poses."""
        return all(pose.is_stable for pose in self.poses)

    @property
    def own(self) -> MarginsResult:
        """Those with the robot's own payload."""
        count = sum(pose.payload == self.poses[0].payload for pose in self.poses)
        return MarginsResult(self.scene, self.poses[:count], self.linear[:count])

    @property
    def worst(self) -> LoopMargins:
        """The worst value of each margin over all poses, all payloads and all cuts."""
        rows = [row for pose in self.poses for row in pose.loops]
        found: dict[str, Any] = {"channel": "worst"}
        for name in (field.name for field in fields(LoopMargins) if field.name != "channel"):
            values = [value for row in rows if not isnan(value := getattr(row, name))]
            found[name] = (max if name in BETTER_IF_LESS else min)(values, default=nan)
        # a loop that is unstable at a pose has neither there
        if not all(pose.is_stable for pose in self.poses):
            found |= {"sensitivity_peak": nan, "bandwidth": nan}
        return LoopMargins(**found)

    def rows(self) -> list[dict[str, Any]]:
        """A row for each pose and each cut, in SI units."""
        names = [field.name for field in fields(LoopMargins)]
        return [
            {
                "s": pose.s,
                "x": pose.position[0],
                "y": pose.position[1],
                "payload": pose.payload,
                "stable": pose.is_stable,
            }
            | {"radius": pose.radius}
            | {name: getattr(row, name) for name in names}
            for pose in self.poses
            for row in pose.loops
        ]


@one_blas_thread()
def scene_margins(
    scene: Scene,
    *,
    poses: int = POSES,
    payloads: Sequence[float] = (),
    progress: Callable[[float], None] = lambda fraction: None,
) -> MarginsResult:
    """The margins of a scene's loop at equilibria along its path, and at the worst ones.

    Args:
        scene: the scene, driven by torques, with controllers.
        poses: number of poses, equally spaced along the path; between them the worst values are searched. 1 for the end alone.
        payloads: lightest and heaviest payload [kg]; the worst values are searched between them, too.
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
    path = PathLoop(wired, loop.motion)

    def margins_at(place: Place) -> tuple[PoseMargins, LinearLoop]:
        s, payload = place.s, place.payload
        found = [
            (pose_margins(linear, names, s, path.position(s), path.joints(s), payload), linear)
            for linear, names in path.loops(place)
        ]
        # where the motion passes twice, the worse of both
        return min(found, key=lambda each: min(each[0].measures))

    def measures(each: tuple[PoseMargins, LinearLoop]) -> tuple[float, ...]:
        return each[0].measures

    given = np.linspace(0.0, 1.0, poses).tolist() if poses > 1 else [1.0]
    searched = [*given, *path.breakpoints(scene)] if poses > 1 else given
    found = worst_places(margins_at, measures, searched, (path.payload, *payloads), progress)
    # the poses that were asked for, and the worst ones: with the robot's own payload, and with any
    own = {place: each for place, each in found.items() if place.payload == path.payload}
    worst = [*least_places(own, measures), *least_places(found, measures)]
    chosen = [place for place in found if place in worst or (place.s in given and place.payload == path.payload)]
    chosen.sort(key=lambda place: (place.payload != path.payload, place.payload, place.s))
    results = [found[each] for each in chosen]
    counts = coarse_counts(scene, loop, wired)
    return MarginsResult(scene, tuple(pose for pose, _ in results), tuple(linear for _, linear in results), counts)

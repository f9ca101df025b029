"""What the labels of the paper's tables stand for: scenes of the experiment, one for each curve and motion profile."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

from flexfmu.cosim.paper.reference import PrintedTable, read_data
from flexfmu.model.scene import Scene
from flexfmu.model.scene_file import load_scene

TRAJECTORY_SCENE = "barnard2012-6kg"
"""Scene whose path the tables and figures of trajectories alone refer to; the payload doesn't matter to them."""

TRAJECTORY_DURATION = 1.0
"""Cycle time of the paper's comparison of trajectories (Tables 5 and 6, Figs. 7 to 11) [s]."""

Case = tuple[str, str, str]
"""A simulation: shipped scene, motion profile (row), curve (column)."""


def curves() -> Mapping[str, Mapping[str, Any]]:
    """Label of a curve → the scene's ``trajectory.blend``."""
    return _cases()["curves"]


def profiles() -> Mapping[str, Mapping[str, Any]]:
    """Label of a motion profile → the scene's ``trajectory.profile``."""
    return _cases()["profiles"]


def case_scene(scene: str, profile: str, curve: str, **changes: Any) -> Scene:
    """The shipped scene with another motion profile and another curve.

    Args:
        scene: name of a shipped scene.
        profile, curve: labels as in the paper's tables.
        changes: further keys of the scene's trajectory section, for example ``duration=1.0``.

    Raises:
        KeyError: no such label.
        SceneError: the scene doesn't exist, or a change can't be right.
    """
    trajectory = {"profile": dict(profiles()[profile]), "blend": dict(curves()[curve]), **changes}
    return load_scene(scene).replace({f"trajectory.{key}": value for key, value in trajectory.items()})


def trajectory_scene(profile: str, curve: str, **changes: Any) -> Scene:
    """The scene of the comparison of trajectories: a cycle time of 1 s."""
    return case_scene(TRAJECTORY_SCENE, profile, curve, duration=TRAJECTORY_DURATION, **changes)


def simulated_cases(tables: Iterable[PrintedTable]) -> tuple[Case, ...]:
    """Every simulation that the tables need, once each and in the order of the tables.

    The two labels of the clothoid pair (``Clothoid``, ``Clot.``) are one simulation.
    """
    cases = (
        (table.scene, row, canonical_curve(column))
        for table in tables
        if table.scene
        for quantity in table.quantities
        for row in quantity.rows
        if row in profiles()
        for column in quantity.columns
    )
    return tuple(dict.fromkeys(cases))


def canonical_curve(label: str) -> str:
    """The first label that stands for the same curve."""
    return next(other for other, blend in curves().items() if blend == curves()[label])


@cache
def _cases() -> dict[str, dict[str, Any]]:
    return read_data("cases")

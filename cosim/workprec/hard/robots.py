"""The robots of the suite: few FMUs, whose parameters make the cases."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from flexfmu.cosim.experiment import Run, run_scene
from flexfmu.cosim.planning import MotionPlan
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.model.scene import Scene
from flexfmu.model.scene_file import load_scene

TOLERANCE = 1e-7
"""Of the FMUs, where a case says nothing else."""

ALLOWED = 10.0 * TOLERANCE
"""Largest error, relative to what elasticity does, that passes."""

STEP = 1e-3
"""Communication step [s], where a case says nothing else."""


@lru_cache(maxsize=1)
def paper_robot() -> Scene:
    """The paper's robot with 6 kg: 3 bending modes in each proximal link, 3 axial ones in each distal link."""
    return load_scene("barnard2012-6kg")


@lru_cache(maxsize=16)
def fmu_of(robot: Scene) -> Path:
    """The FMU of a robot, from the cache where it is there."""
    return build_scene(robot).path


def run_case(
    robot: Scene,
    changes: Mapping[str, Any] | None = None,
    *,
    step: float = STEP,
    tolerance: float = TOLERANCE,
    motion: MotionPlan | None = None,
) -> Run:
    """Co-simulate a robot whose parameters or motion differ from those that its FMU was built for.

    Args:
        robot: scene of the FMU.
        changes: dotted key → value; effects stay.
        step: communication step [s].
        tolerance: relative, of the FMU's integrator.
        motion: instead of the scene's own.
    """
    scene = robot.replace(dict(changes or {}))
    return run_scene(scene, fmu_path=fmu_of(robot), communication_step=step, tolerance=tolerance, motion=motion)

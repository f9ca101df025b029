"""What a hard case is, what a run of it shows, and the robots that all cases are made of: few FMUs with parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.prepared_scene import Run, run_scene
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


@dataclass(frozen=True)
class Criterion:
    """One number that says whether a case went well.

    Attributes:
        name: what is measured.
        value: what was found; a NaN never passes.
        limit: the most that is right.
        unit: of both; empty for a relative number or a count.
    """

    name: str
    value: float
    limit: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is a number up to the limit."""
        return self.value <= self.limit

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        mark = "" if self.passed else f" (more than {self.limit:.2g}{unit})"
        return f"{self.name} {self.value:.2g}{unit}{mark}"


@dataclass(frozen=True)
class CaseReport:
    """What happened in a case.

    Attributes:
        happened: in words, without the figures of the checks.
        checks: what was measured, with limits.
    """

    happened: str
    checks: tuple[Criterion, ...]

    @property
    def passed(self) -> bool:
        """Whether all checks pass, and there are any."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    def value(self, name: str) -> float:
        """The value of a check by its name."""
        return next(check.value for check in self.checks if check.name == name)


@dataclass(frozen=True)
class HardCase:
    """A case of the suite.

    Attributes:
        name: short, unique, for tables and tests.
        hard: what makes it hard, with a number.
        run: runs it.
    """

    name: str
    hard: str
    run: Callable[[], CaseReport]


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

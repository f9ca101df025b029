"""Common parts of the hard cases: the paper's robot, a run of it with other parameters, and the criteria that every finished run has to meet:
finite numbers, an assembled mechanism on the branch of its start, and the same motion as SciPy's solvers find.

The closure residual and the branch are recomputed from joint angles, deflections and the end effector, without the FMU's kinematics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.benchmarks.hard_cases.scipy_solution import POSITION, Solver, positions_along
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.assembly import bases
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.schema import Scene


@dataclass(frozen=True)
class Criterion:
    """One number that decides whether a case passes.

    Attributes:
        name: what is measured.
        value: measured value; NaN never passes.
        limit: the largest value that passes.
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
    """The result of running a case.

    Attributes:
        happened: the outcome as text, without the figures of the criteria.
        checks: the criteria with their measured values.
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
"""Relative tolerance of the FMUs, unless a case has its own."""

ALLOWED = 10.0 * TOLERANCE
"""Largest error, relative to the largest elastic deviation, that passes."""

STEP = 1e-3
"""Communication step [s], unless a case has its own."""


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


LOOP_SIGNALS = (
    *POSITION,
    *(f"joint{leg}.reference.position" for leg in (1, 2)),
    *(f"link{leg}1.tip_deflection" for leg in (1, 2)),
    *(f"link{leg}2.elongation" for leg in (1, 2)),
)
"""Signals from which the closure is recomputed; without deflections, links are rigid."""


@dataclass(frozen=True)
class LoopGeometry:
    """The closed loop at N instants.

    Attributes:
        residual: (N,) largest distance by which a distal link fails to reach from its elbow to the end effector [m].
        sine: (N,) of the angle between the distal links, positive on the assembly side of the mechanism.
    """

    residual: RealArray
    sine: RealArray


def loop_geometry(mechanism: Mechanism, recording: Recording) -> LoopGeometry:
    """From joint references, deflections and end effector, for links that bend next to the bases and stretch beyond the
    elbows, if at all."""

    def deflection(name: str) -> RealArray:
        """(N,) [m]; zero for a rigid link."""
        return recording[name].values if name in recording.columns else np.zeros(recording.time.size)

    tip = np.stack([recording[name].values for name in POSITION], axis=1)
    arms, residuals = [], []
    for leg, base in zip((1, 2), bases(mechanism), strict=True):
        # the distal link as a vector from its elbow to the end effector, and by how much its length is wrong
        angle = recording[f"joint{leg}.reference.position"].values
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        sag = deflection(f"link{leg}1.tip_deflection")[:, None]
        arm = tip - (np.asarray(base) + mechanism.proximal.length * along + sag * across)
        length = mechanism.distal.length + deflection(f"link{leg}2.elongation")
        residuals.append(abs(np.linalg.norm(arm, axis=1) - length))
        arms.append(arm / length[:, None])
    # sine between both distal links, by their cross product
    (x1, y1), (x2, y2) = arms[0].T, arms[1].T
    side = 1.0 if mechanism.assembly_mode == "left" else -1.0
    return LoopGeometry(np.max(residuals, axis=0), side * (x1 * y2 - y1 * x2))


SAMPLES = 0.01
"""Distance of the instants at which the end effector is compared [s]."""

ROUNDING = 1e-14
"""Closure residual [m] that rounding of lengths around 1 m leaves, with room for some dozens of operations."""

NOT_FINITE, UNFINISHED, ERROR, CLOSURE = (
    "numbers that are NaN or infinite",
    "part not simulated",
    "error",
    "closure residual",
)
OFF_BRANCH = "instants off the branch"


def error_against(run: Run, robot: Scene, solver: Solver, limit: float) -> Criterion:
    """Largest distance of the end effector from the reference, relative to the largest elastic deviation.

    Args:
        run: what is judged.
        robot: a scene of the same effects whose equations are taken.
        solver: of the reference.
        limit: largest error that passes.
    """
    # instants about `SAMPLES` apart, from the communication points
    wanted = np.arange(SAMPLES, run.plan.stop_time, SAMPLES)
    chosen = np.unique(np.searchsorted(run.recording.time, wanted - 1e-9).clip(0, run.recording.time.size - 1))
    instants = run.recording.time[chosen]
    positions = np.stack([run.recording[name].values for name in POSITION], axis=1)[chosen]
    # the reference's absolute tolerance follows from the deflections of the run
    rigid = run.plan.task.evaluate(instants, 0)[0]
    size = float(np.linalg.norm(positions - rigid, axis=1).max())
    reference = positions_along(robot, run.scene, run.plan, instants, solver, size)
    scale = float(np.linalg.norm(reference - rigid, axis=1).max())
    error = float(np.linalg.norm(positions - reference, axis=1).max()) / scale
    return Criterion(f"{ERROR} ({solver.method})", error, limit)


def soundness(run: Run) -> tuple[Criterion, ...]:
    """Criteria of every finished run: stop time reached, finite numbers, mechanism closed and on its initial branch throughout."""
    geometry = loop_geometry(run.scene.mechanism, run.recording)
    end = float(run.recording.time[-1])
    return (
        Criterion(UNFINISHED, 1.0 - end / run.plan.stop_time, 0.0),
        not_finite(run.recording),
        Criterion(CLOSURE, float(geometry.residual.max()), ROUNDING, "m"),
        off_branch(geometry.sine),
    )


def off_branch(sine: RealArray) -> Criterion:
    """Number of instants at which the mechanism is on the other assembly branch, or not assembled."""
    return Criterion(OFF_BRANCH, float(np.count_nonzero(~(sine > 0.0))), 0.0)


def not_finite(recording: Recording) -> Criterion:
    """Number of recorded values and derivatives that are infinite or NaN."""
    tables = [
        table
        for column in recording.columns.values()
        for table in (column.values, column.first, column.second)
        if table is not None
    ]
    return Criterion(NOT_FINITE, float(sum(np.count_nonzero(~np.isfinite(table)) for table in tables)), 0.0)

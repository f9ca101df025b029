"""Checks that every finished run has to pass: finite, assembled, on its branch, and equal to what SciPy's solvers compute."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.studies.hard.case import Criterion
from flexfmu.cosim.studies.hard.scipy_solution import POSITION, Solver, positions_along
from flexfmu.model.scene.assembly import bases
from flexfmu.model.scene.mechanism import Mechanism
from flexfmu.model.scene.schema import Scene

LOOP_SIGNALS = (
    *POSITION,
    *(f"joint{leg}.reference.position" for leg in (1, 2)),
    *(f"link{leg}1.tip_deflection" for leg in (1, 2)),
    *(f"link{leg}2.elongation" for leg in (1, 2)),
)
"""What the closure is recomputed from; without deflections, links are rigid."""


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
    tip = np.stack([recording[name].values for name in POSITION], axis=1)
    arms, residuals = [], []
    for leg, base in zip((1, 2), bases(mechanism), strict=True):
        angle = recording[f"joint{leg}.reference.position"].values
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        sag = _deflection(recording, f"link{leg}1.tip_deflection")[:, None]
        arm = tip - (np.asarray(base) + mechanism.proximal.length * along + sag * across)
        length = mechanism.distal.length + _deflection(recording, f"link{leg}2.elongation")
        residuals.append(abs(np.linalg.norm(arm, axis=1) - length))
        arms.append(arm / length[:, None])
    (x1, y1), (x2, y2) = arms[0].T, arms[1].T
    side = 1.0 if mechanism.assembly_mode == "left" else -1.0
    return LoopGeometry(np.max(residuals, axis=0), side * (x1 * y2 - y1 * x2))


def _deflection(recording: Recording, name: str) -> RealArray:
    """(N,) [m]; zero for a rigid link."""
    return recording[name].values if name in recording.columns else np.zeros(recording.time.size)


SAMPLES = 0.01
"""Distance of the instants at which the end effector is compared [s]."""

ROUNDING = 1e-14
"""Closure residual [m] that rounding of lengths around 1 m leaves, with room for some dozens of operations."""

NOT_FINITE, UNFINISHED, ERROR, CLOSURE = "numbers not finite", "part not simulated", "error", "closure residual"
OFF_BRANCH = "instants off the branch"


def error_against(run: Run, robot: Scene, solver: Solver, limit: float) -> Criterion:
    """Largest distance of the end effector from the reference, relative to what elasticity does.

    Args:
        run: what is judged.
        robot: a scene of the same effects whose equations are taken.
        solver: of the reference.
        limit: largest error that passes.
    """
    chosen = _sampled(run)
    instants, positions = run.recording.time[chosen], _positions(run.recording)[chosen]
    rigid = run.plan.task.evaluate(instants, 0)[0]
    size = float(np.linalg.norm(positions - rigid, axis=1).max())
    reference = positions_along(robot, run.scene, run.plan, instants, solver, size)
    scale = float(np.linalg.norm(reference - rigid, axis=1).max())
    error = float(np.linalg.norm(positions - reference, axis=1).max()) / scale
    return Criterion(f"{ERROR} ({solver.method})", error, limit)


def _sampled(run: Run) -> NDArray[np.int64]:
    """Indices of instants about `SAMPLES` apart."""
    time = run.recording.time
    wanted = np.arange(SAMPLES, run.plan.stop_time, SAMPLES)
    return np.unique(np.searchsorted(time, wanted - 1e-9).clip(0, time.size - 1))


def _positions(recording: Recording) -> RealArray:
    """(N, 2) end effector [m]."""
    return np.stack([recording[name].values for name in POSITION], axis=1)


def soundness(run: Run) -> tuple[Criterion, ...]:
    """It reached its end, with numbers alone, and the mechanism is assembled at every instant, on the branch of its start."""
    geometry = loop_geometry(run.scene.mechanism, run.recording)
    end = float(run.recording.time[-1])
    return (
        Criterion(UNFINISHED, 1.0 - end / run.plan.stop_time, 0.0),
        not_finite(run.recording),
        Criterion(CLOSURE, float(geometry.residual.max()), ROUNDING, "m"),
        off_branch(geometry.sine),
    )


def off_branch(sine: RealArray) -> Criterion:
    """At how many instants the end effector is on the other side of the elbows, or nowhere."""
    return Criterion(OFF_BRANCH, float(np.count_nonzero(~(sine > 0.0))), 0.0)


def not_finite(recording: Recording) -> Criterion:
    """How many recorded numbers are infinite or none at all, derivatives included."""
    tables = [
        table
        for column in recording.columns.values()
        for table in (column.values, column.first, column.second)
        if table is not None
    ]
    return Criterion(NOT_FINITE, float(sum(np.count_nonzero(~np.isfinite(table)) for table in tables)), 0.0)

"""The paper's simulations: the scenes that its labels stand for, every profile on every curve, for both payloads, through one FMU."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.prepared_scene import Run, run_scene
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.studies.paper.comparison import EvaluateCell
from flexfmu.cosim.studies.paper.reference import PrintedTable, read_data
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


class PaperError(CosimError):
    """A simulation of the paper's experiment failed."""


TRAJECTORY_SCENE = "barnard2012-6kg"
"""Scene whose path the tables and figures of trajectories alone refer to; the payload doesn't matter to them."""

TRAJECTORY_DURATION = 1.0
"""Cycle time of the paper's comparison of trajectories (Tables 5 and 6, Figs. 7 to 11) [s]."""

PaperCase = tuple[str, str, str]
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


def simulated_cases(tables: Iterable[PrintedTable]) -> tuple[PaperCase, ...]:
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


@dataclass(frozen=True)
class SimulatedCase:
    """What is kept of a run.

    Attributes:
        case: shipped scene, motion profile, curve.
        metrics: name → value in SI units.
        duration: duration of the motion [s].
        time, path_error: instants [s] and norm of the end effector's position error [m], over motion and dwell.
        fmu_path: the FMU that was simulated.
        simulation_time: wall-clock time [s].
    """

    case: PaperCase
    metrics: Mapping[str, float | None]
    duration: float
    time: RealArray
    path_error: RealArray
    fmu_path: Path
    simulation_time: float


def simulate(cases: Iterable[PaperCase]) -> Iterator[SimulatedCase]:
    """Run the cases one after the other; the FMU of the first, with other parameters, serves them all.

    Raises:
        PaperError: a simulation didn't reach its end.
    """
    fmu = None
    for case in cases:
        run = run_scene(case_scene(*case), fmu_path=fmu)
        if not run.completed:
            raise PaperError(f"{', '.join(case)}: {run.message}")
        fmu = run.fmu_path
        yield _simulation(case, run)


def simulation_evaluators(simulations: Mapping[PaperCase, SimulatedCase], scene: str) -> Mapping[str, EvaluateCell]:
    """Metric → function of row and column, for a table about the simulations of a scene."""
    return {metric: _evaluator(simulations, scene, metric) for metric in METRICS}


def path_error(run: Run) -> RealArray:
    """Norm of the difference between the end effector's position and the rigid robot's, (N,) [m]."""
    x, y = (
        run.recording[f"end_effector.position.{axis}"].values
        - run.recording[f"end_effector.reference.position.{axis}"].values
        for axis in "xy"
    )
    return np.hypot(x, y)


def _simulation(case: PaperCase, run: Run) -> SimulatedCase:
    return SimulatedCase(
        case=case,
        metrics={name: measurement.value for name, measurement in measure_run(run, companions=0).items()},
        duration=run.plan.duration,
        time=run.recording.time,
        path_error=path_error(run),
        fmu_path=run.fmu_path,
        simulation_time=run.timing.simulate,
    )


def _evaluator(simulations: Mapping[PaperCase, SimulatedCase], scene: str, metric: str) -> EvaluateCell:
    def evaluate(row: str, column: str) -> float:
        value = simulations[scene, row, canonical_curve(column)].metrics[metric]
        if value is None:
            raise PaperError(f"{scene}, {row}, {column}: the simulation has no {metric}")
        return value

    return evaluate


def write_simulations(simulations: Iterable[SimulatedCase], folder: Path) -> None:
    """Write all metrics of the simulations (SI units) to ``simulations.csv``, one line each.

    Raises:
        ResultsError: the folder can't be written.
    """
    lines = [",".join(("scene", "profile", "curve", *METRICS, "simulation_time"))]
    for simulation in simulations:
        values = [*(simulation.metrics[name] for name in METRICS), simulation.simulation_time]
        figures = ("" if value is None else f"{value:.9g}" for value in values)
        lines.append(",".join((*simulation.case, *figures)))
    OutputFolder(folder).write("simulations.csv", "\n".join(lines) + "\n")

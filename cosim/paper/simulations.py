"""The paper's simulations: every profile on every curve, for both payloads, through one FMU."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.experiment import Run, run_scene
from flexfmu.cosim.measuring.metric_table import METRICS
from flexfmu.cosim.metrics import measure_run
from flexfmu.cosim.paper.cases import Case, canonical_curve, case_scene
from flexfmu.cosim.paper.comparison import Evaluate
from flexfmu.cosim.paper.errors import PaperError

Series = NDArray[np.float64]


@dataclass(frozen=True)
class Simulation:
    """What is kept of a run.

    Attributes:
        case: shipped scene, motion profile, curve.
        metrics: name → value in SI units.
        duration: duration of the motion [s].
        time, path_error: instants [s] and norm of the end effector's position error [m], over motion and dwell.
        fmu_path: the FMU that was simulated.
        simulation_time: wall-clock time [s].
    """

    case: Case
    metrics: Mapping[str, float | None]
    duration: float
    time: Series
    path_error: Series
    fmu_path: Path
    simulation_time: float


def simulate(cases: Iterable[Case]) -> Iterator[Simulation]:
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


def evaluators(simulations: Mapping[Case, Simulation], scene: str) -> Mapping[str, Evaluate]:
    """Metric → function of row and column, for a table about the simulations of a scene."""
    return {metric: _evaluator(simulations, scene, metric) for metric in METRICS}


def path_error(run: Run) -> Series:
    """Norm of the difference between the end effector's position and the rigid robot's, (N,) [m]."""
    x, y = (
        run.recording[f"end_effector.position.{axis}"].values
        - run.recording[f"end_effector.reference.position.{axis}"].values
        for axis in "xy"
    )
    return np.hypot(x, y)


def _simulation(case: Case, run: Run) -> Simulation:
    return Simulation(
        case=case,
        metrics={name: measurement.value for name, measurement in measure_run(run, companions=0).items()},
        duration=run.plan.duration,
        time=run.recording.time,
        path_error=path_error(run),
        fmu_path=run.fmu_path,
        simulation_time=run.timing.simulate,
    )


def _evaluator(simulations: Mapping[Case, Simulation], scene: str, metric: str) -> Evaluate:
    def evaluate(row: str, column: str) -> float:
        value = simulations[scene, row, canonical_curve(column)].metrics[metric]
        if value is None:
            raise PaperError(f"{scene}, {row}, {column}: the simulation has no {metric}")
        return value

    return evaluate

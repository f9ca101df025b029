"""The computed values beside the paper's printed figures: lengths of curves, largest accelerations, natural frequencies along the path,
and the metrics of every motion profile on every curve, for both payloads, simulated with one FMU.

The paper names its scenes by labels (``7th order polynomial``, ``Lamé``); `case_scene` turns these into a shipped scene with
another profile and another blend. An evaluator maps the labels of a row and a column to the computed value in SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.prepared_scene import Run, run_scene
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.studies.paper.comparison import EvaluateCell, PrintedTable, read_data
from flexfmu.model.modes import natural_frequencies
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory


class PaperError(CosimError):
    """A simulation of the paper's experiment failed."""


TRAJECTORY_SCENE = "barnard2012-6kg"
"""Scene whose path the tables and figures of trajectories alone refer to; the payload doesn't matter to them."""

TRAJECTORY_DURATION = 1.0
"""Cycle time of the paper's comparison of trajectories (Tables 5 and 6, Figs. 7 to 11) [s]."""

PaperCase = tuple[str, str, str]
"""A simulation: shipped scene, motion profile (row), curve (column)."""


@cache
def curves() -> Mapping[str, Mapping[str, Any]]:
    """Label of a curve → the scene's ``trajectory.blend``."""
    found: Mapping[str, Mapping[str, Any]] = read_data("cases")["curves"]
    return found


@cache
def profiles() -> Mapping[str, Mapping[str, Any]]:
    """Label of a motion profile → the scene's ``trajectory.profile``."""
    found: Mapping[str, Mapping[str, Any]] = read_data("cases")["profiles"]
    return found


def case_scene(scene: str, profile: str, curve: str, **changes: Any) -> Scene:
    """The shipped scene with another motion profile and another curve.

    Args:
        scene: name of a shipped scene.
        profile, curve: labels as in the paper's tables.
        changes: further keys of the scene's trajectory section, for example ``duration=1.0``.

    Raises:
        KeyError: no such label.
        SceneError: the scene doesn't exist, or a changed value is out of range.
    """
    trajectory = {"profile": dict(profiles()[profile]), "blend": dict(curves()[curve]), **changes}
    return load_scene(scene).replace({f"trajectory.{key}": value for key, value in trajectory.items()})


def trajectory_scene(profile: str, curve: str, **changes: Any) -> Scene:
    """The scene of the comparison of trajectories: a cycle time of 1 s."""
    return case_scene(TRAJECTORY_SCENE, profile, curve, duration=TRAJECTORY_DURATION, **changes)


POINTS = 2001
"""Instants between two breakpoints: a smooth maximum is met to about (pi / POINTS)²/8 < 1e-6 relative."""


def motion_evaluators() -> Mapping[str, EvaluateCell]:
    """Metric → function of row and column, for the metrics that need no simulation."""
    return {
        "blend_length": lambda row, column: blend_length(row),
        "path_length": lambda row, column: path_length(column),
        "peak_task_acceleration": peak_task_acceleration,
        "peak_joint_acceleration_1": peak_joint_acceleration,
    }


def blend_length(curve: str) -> float:
    """Arc length of one blend [m]; it doesn't depend on the motion profile, so any will do."""
    return plan(trajectory_scene(next(iter(profiles())), curve)).profiled.path.blend.curve.length


def path_length(curve: str) -> float:
    """Arc length of the whole path [m]; it doesn't depend on the motion profile, so any will do."""
    return plan(trajectory_scene(next(iter(profiles())), curve)).profiled.path.length


def peak_task_acceleration(profile: str, curve: str) -> float:
    """Largest norm of the end effector's acceleration [m/s²], both sides of every jump included."""
    task = plan(trajectory_scene(profile, curve)).task
    return maximum(task, lambda derivatives: np.hypot(derivatives[2, :, 0], derivatives[2, :, 1]))


def peak_joint_acceleration(profile: str, curve: str) -> float:
    """Largest signed second derivative of q11 [rad/s²]."""
    joints = plan(trajectory_scene(profile, curve)).joints
    return maximum(joints, lambda derivatives: derivatives[2, :, 0])


def maximum(trajectory: Trajectory, quantity: Callable[[RealArray], RealArray]) -> float:
    """Largest value of a quantity over the motion.

    Args:
        trajectory: the motion.
        quantity: function of the trajectory's derivatives (order + 1, N, 2) with a result of shape (N,).
    """
    return max(float(np.max(quantity(derivatives))) for _, derivatives in smooth_pieces(trajectory, POINTS))


def smooth_pieces(trajectory: Trajectory, points: int, order: int = 2) -> Iterator[tuple[RealArray, RealArray]]:
    """Times (N,) and derivatives (order + 1, N, 2) between neighbouring breakpoints, with one-sided limits at both."""
    for begin, end in pairwise(trajectory.breakpoints):
        time = np.linspace(begin, end, points)
        before = trajectory.evaluate(time[:-1], order=order, side="right")
        last = trajectory.evaluate(time[-1:], order=order, side="left")
        yield time, np.concatenate([before, last], axis=1)


POSES = 41
"""Poses along the path, start, middle and end included."""

FREQUENCY_ROWS: Mapping[str, tuple[str, int]] = {
    "first, 6 kg": ("barnard2012-6kg", 0),
    "first, 0.1 kg": ("barnard2012-0.1kg", 0),
    "third, 0.1 kg": ("barnard2012-0.1kg", 2),
}
"""Row of the comparison → scene, and index of the frequency in ascending order."""


def frequency_evaluators() -> Mapping[str, EvaluateCell]:
    """The metric of the frequencies' comparison → function of row and column."""
    # (poses, n) frequencies [Hz], ascending, at equally spaced instants of the motion along the Lamé path
    frequencies = {}
    for name in dict.fromkeys(name for name, _ in FREQUENCY_ROWS.values()):
        scene = case_scene(name, "7th order polynomial", "Lamé")
        joints = plan(scene).joints
        poses = joints.evaluate(np.linspace(0.0, joints.duration, POSES), order=0)[0]
        frequencies[name] = np.stack([natural_frequencies(scene, pose) for pose in poses])

    def evaluate(row: str, column: str) -> float:
        name, index = FREQUENCY_ROWS[row]
        lowest, highest = frequencies[name][:, index].min(), frequencies[name][:, index].max()
        return float({"centre": highest + lowest, "half range": highest - lowest}[column] / 2)

    return {"natural_frequency": evaluate}


@dataclass(frozen=True)
class SimulatedCase:
    """The results of a run.

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


def simulated_cases(tables: Iterable[PrintedTable]) -> tuple[PaperCase, ...]:
    """Every simulation that the tables need, once each and in the order of the tables.

    The two labels of the clothoid pair (``Clothoid``, ``Clot.``) are one simulation.
    """
    # tables repeat curves under other labels and share simulations
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
    """The first label of the same curve."""
    return next(other for other, blend in curves().items() if blend == curves()[label])


def simulate(cases: Iterable[PaperCase]) -> Iterator[SimulatedCase]:
    """Run the cases one after the other; all use the FMU of the first, with their own parameters.

    Raises:
        PaperError: a simulation didn't reach its end.
    """
    fmu = None
    for case in cases:
        run = run_scene(case_scene(*case), fmu_path=fmu)
        # an incomplete run has no metrics to compare
        if not run.completed:
            raise PaperError(f"{', '.join(case)}: {run.message}")
        fmu = run.fmu_path
        yield SimulatedCase(
            case=case,
            metrics={name: measurement.value for name, measurement in measure_run(run, companions=0).items()},
            duration=run.plan.duration,
            time=run.recording.time,
            path_error=path_error(run),
            fmu_path=run.fmu_path,
            simulation_time=run.timing.simulate,
        )


def path_error(run: Run) -> RealArray:
    """Norm of the difference between the end effector's position and the rigid robot's, (N,) [m]."""
    x, y = (
        run.recording[f"end_effector.position.{axis}"].values
        - run.recording[f"end_effector.reference.position.{axis}"].values
        for axis in "xy"
    )
    return np.hypot(x, y)


def simulation_evaluators(simulations: Mapping[PaperCase, SimulatedCase], scene: str) -> Mapping[str, EvaluateCell]:
    """Metric → function of row and column, for a table about the simulations of a scene."""

    def evaluator(metric: str) -> EvaluateCell:
        def evaluate(row: str, column: str) -> float:
            value = simulations[scene, row, canonical_curve(column)].metrics[metric]
            if value is None:
                raise PaperError(f"{scene}, {row}, {column}: the simulation has no {metric}")
            return value

        return evaluate

    return {metric: evaluator(metric) for metric in METRICS}


def write_simulations(simulations: Iterable[SimulatedCase], folder: Path) -> None:
    """Write all metrics of the simulations (SI units) to ``simulations.csv``, one line each.

    Raises:
        ResultsError: the folder can't be written.
    """
    # nine digits, so that files of equal runs are equal
    lines = [",".join(("scene", "profile", "curve", *METRICS, "simulation_time"))]
    for simulation in simulations:
        values = [*(simulation.metrics[name] for name in METRICS), simulation.simulation_time]
        figures = ("" if value is None else f"{value:.9g}" for value in values)
        lines.append(",".join((*simulation.case, *figures)))
    OutputFolder(folder).write("simulations.csv", "\n".join(lines) + "\n")

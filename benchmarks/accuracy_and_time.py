"""The cost of accuracy: the paper's motion of 0.43 s with a dwell of 0.25 s, at several tolerances and communication steps.

Position and torque: largest difference over the whole run to a run with a tolerance of 1e-12, relative to the peak position
error (the largest elastic deviation, not the size of the path) and to the peak torque. Any metric: largest relative difference of all
metrics to those of the finest run, interpolation between the communication points included.
Times are processor times of the co-simulation, master and recording included, the best of several runs.

    python benchmarks/accuracy_and_time.py [--repeat 7] [--json]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from paper_scene import SCENE, best_times, whole_run

from flexfmu import measure_run
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene

TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9)
STEPS = (2e-4, 1e-3, 5e-3)
REFERENCE_TOLERANCE = 1e-12
FMU = build_scene(SCENE).path


@dataclass(frozen=True)
class Row:
    """One line of the table; times in seconds, errors relative."""

    communication_step: float
    tolerance: float
    integrator_steps: int
    evaluations: int
    time: float
    real_time_factor: float
    position_error: float
    torque_error: float
    metric_error: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="The cost of accuracy in time.")
    parser.add_argument("--repeat", type=int, default=7, help="runs of which the fastest counts")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    options = parser.parse_args()
    rows = measure(options.repeat)
    if options.json:
        print(json.dumps([asdict(each) for each in rows], indent=2))
        return
    print("   step   tolerance   time    x real time   steps   evaluations   position   torque   any metric")
    for each in rows:
        print(
            f"{1e3 * each.communication_step:5.1f} ms   {each.tolerance:7.0e} {1e3 * each.time:6.1f} ms"
            f" {each.real_time_factor:9.1f} {each.integrator_steps:11d} {each.evaluations:11d}"
            f"      {each.position_error:8.1e} {each.torque_error:8.1e} {each.metric_error:9.1e}"
        )


def measure(repeat: int) -> list[Row]:
    """All tolerances at all communication steps."""
    finest = metrics_of(simulate(min(STEPS), REFERENCE_TOLERANCE))
    exact = {step: simulate(step, REFERENCE_TOLERANCE) for step in STEPS}
    cases = [(step, tolerance) for step in STEPS for tolerance in TOLERANCES]
    times = best_times([whole_run(SCENE, *case, fmu_path=FMU) for case in cases], repeat)
    return [row(simulate(*case), exact[case[0]], finest, time) for case, time in zip(cases, times, strict=True)]


def row(run: Run, exact: Run, finest: Mapping[str, float], time: float) -> Row:
    """One line of the table."""
    position = max(largest_difference(run, exact, f"end_effector.position.{axis}") for axis in "xy")
    torque = max(largest_difference(run, exact, f"joint{joint}.torque") for joint in (1, 2))
    changes = [abs(value / finest[name] - 1.0) for name, value in metrics_of(run).items()]
    return Row(
        communication_step=run.communication_step,
        tolerance=run.tolerance,
        integrator_steps=run.health.statistics["steps"],
        evaluations=run.health.statistics["evaluations"],
        time=time,
        real_time_factor=run.plan.stop_time / time,
        position_error=position / finest["peak_position_error"],
        torque_error=torque / finest["peak_torque_1"],
        metric_error=max(changes),
    )


def simulate(step: float, tolerance: float) -> Run:
    """One run with the FMU from the cache."""
    return run_scene(SCENE, communication_step=step, tolerance=tolerance, fmu_path=FMU)


def metrics_of(run: Run) -> dict[str, float]:
    """The metrics that have a value."""
    return {name: each.value for name, each in measure_run(run, companions=0).items() if each.value is not None}


def largest_difference(run: Run, exact: Run, signal: str) -> float:
    """Largest difference of a signal at all communication points."""
    return float(np.max(np.abs(run.recording[signal].values - exact.recording[signal].values)))


if __name__ == "__main__":
    main()

"""What recording costs: steps chosen from the motion against steps of 1 ms, short steps, and the memory of long runs. Used by
`speed.py`; not a script of its own, except for the runs in processes of their own: python speed_recording.py all|one|short."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from long_runs import LOOP, peak
from paper_scene import SCENE, SCENES, best_times, run_and_read, timed
from speed_figure import SpeedFigure

from flexfmu import load_scene
from flexfmu.cosim.engine.errors import CostWarning
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.many.prepared_scene import PreparedScene

STEP = 1e-3
"""Interval of the recorded instants [s]."""

SHORT, LONG = 1e-5, 2e-4
"""Communication steps whose costs are compared [s]."""

TOLERANCE = 1e-5

SECONDS = 60.0
"""Length of the long runs, at 4 kHz [s]."""

ROUNDS = 6


def recording_figures() -> Iterator[SpeedFigure]:
    """Chosen steps, short steps, and memory."""
    for n, scene in SCENES.items():
        exact = PreparedScene(scene, communication_step=STEP, tolerance=1e-11).run().recording
        for what, order in (("values", 0), ("2 derivatives", 2)):
            record = Selection(None, order)
            fixed = PreparedScene(scene, communication_step=STEP, tolerance=TOLERANCE, record=record)
            chosen = PreparedScene(scene.replace({"cosimulation.step": "auto"}), tolerance=TOLERANCE, record=record)
            errors = [_error(each.run().recording, exact) for each in (fixed, chosen)]
            times = best_times([timed(partial(run_and_read, each)) for each in (fixed, chosen)], ROUNDS)
            note = " and ".join(f"{1e3 * t:.2f} ms for an error of {e:.0e}" for t, e in zip(times, errors, strict=True))
            name = f"chosen steps for 1 ms, {n} degrees of freedom, {what}"
            yield SpeedFigure(name, times[0] / times[1], 1.5, "×", True, note)
    costs = [_in_process("short", str(step)) for step in (SHORT, LONG)]
    note = f"{costs[0]:.2f} and {costs[1]:.2f} µs, 2 derivatives recorded"
    yield SpeedFigure("a step of 10 µs, of one of 200 µs", costs[0] / costs[1], 1.1, "×", note=note)
    for what, name, target in (("all", "all signals", 0.6), ("one", "one signal", 0.2)):
        yield SpeedFigure(
            f"memory of 60 s at 4 kHz, {name}", _in_process(what), target, "GB", note="peak of the process"
        )


def _error(found: Recording, exact: Recording) -> float:
    """Largest error of torques and end effector at the instants of both, relative to each signal's largest value."""
    both, here, there = np.intersect1d(np.round(found.time, 9), np.round(exact.time, 9), return_indices=True)
    single = np.isin(both, np.round(exact.time[1:][np.diff(exact.time) == 0.0], 9), invert=True)
    names = [name for name in exact.columns if name.endswith((".torque", "position.x", "position.y"))]
    pairs = ((found[name].values[here[single]], exact[name].values[there[single]]) for name in names)
    return max(float(abs(one - other).max() / abs(other).max()) for one, other in pairs)


def _in_process(*arguments: str) -> float:
    """What this file measures in a process of its own."""
    command = [sys.executable, str(Path(__file__)), *arguments]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main(what: str, step: float = 0.0) -> float:
    """Memory of a long run [GB], or processor time of a step [µs]."""
    if what == "short":
        prepared = PreparedScene(SCENE, communication_step=step, tolerance=TOLERANCE)
        (least,) = best_times([timed(prepared.run)], 1)
        return 1e6 * least * step / prepared.stop_time
    scene = load_scene("barnard2012-0.1kg")
    scene = scene.replace(LOOP | {"trajectory.dwell": SECONDS - scene.trajectory.duration})
    record = Selection() if what == "all" else Selection(["joint1.torque"], 0)
    warnings.simplefilter("ignore", CostWarning)
    run = PreparedScene(scene, record=record).run()
    assert run.completed
    return peak()


if __name__ == "__main__":
    print(main(sys.argv[1], *map(float, sys.argv[2:])))

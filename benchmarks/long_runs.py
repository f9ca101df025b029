"""The predicted and the measured cost of long runs: a closed loop at 4 kHz, or the references of many points.

python benchmarks/long_runs.py [--seconds 75] [--csv]
python benchmarks/long_runs.py --points 2e6
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import warnings
from pathlib import Path
from time import perf_counter

import numpy as np

from flexfmu import load_scene
from flexfmu.cosim.engine.errors import CostWarning
from flexfmu.cosim.engine.master.cost import BYTES_PER_REFERENCE
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.prepared_scene import PreparedScene
from flexfmu.model.scene.schema import Scene

LOOP = {
    "cosimulation.drive": "torque",
    "cosimulation.step": 2.5e-4,
    "effects.motor_inertia": 0.01,
    "controller": [{"kind": "pd", "proportional": 1e3, "derivative": 10.0, "sample_time": 2.5e-4}],
}


def peak() -> float:
    """Most memory so far [GB]."""
    return 1024e-9 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Run, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=75.0, help="motion and dwell [s]")
    parser.add_argument("--csv", action="store_true", help="write results.csv too")
    parser.add_argument("--points", type=float, help="calculate the references of so many points instead")
    options = parser.parse_args()
    scene = load_scene("barnard2012-0.1kg")
    if options.points:
        references(scene, int(options.points))
        return
    prepared = PreparedScene(scene.replace(LOOP | {"trajectory.dwell": options.seconds - scene.trajectory.duration}))
    before, begin = peak(), perf_counter()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", CostWarning)
        run = prepared.run()
    print(f"said: {told[0].message if told else 'nothing'}")
    print(f"simulated: {run.timing.simulate:.3g} s, {perf_counter() - begin:.3g} s in all, {peak() - before:.3g} GB")
    if options.csv:
        with tempfile.TemporaryDirectory() as folder:
            begin = perf_counter()
            size = run.recording.write_csv(Path(folder) / "results.csv").stat().st_size
            print(
                f"results.csv: {perf_counter() - begin:.3g} s, {1e-9 * size:.3g} GB; {peak() - before:.3g} GB of memory"
            )


def references(scene: Scene, points: int) -> None:
    """The references of a motion at so many points: their memory before the first step."""
    slave = TrajectorySlave(plan(scene).joints)
    times = np.linspace(0.0, scene.trajectory.duration, points)
    before = peak()
    slave.prepare(times)
    print(f"said: {BYTES_PER_REFERENCE * 1e-9 * len(slave.variables) * points:.3g} GB")
    print(f"taken: {peak() - before:.3g} GB")


if __name__ == "__main__":
    main()

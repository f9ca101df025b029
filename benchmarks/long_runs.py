"""The predicted and the measured cost of long runs: a closed loop at 4 kHz; and what many different scenes cost in one process.

python benchmarks/long_runs.py [--seconds 75] [--csv] | --scenes 500
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import warnings
from pathlib import Path
from time import perf_counter, process_time

from flexfmu import load_scene, run
from flexfmu.cosim.engine.errors import CostWarning
from flexfmu.cosim.many.prepared_scene import PreparedScene

LOOP = {
    "cosimulation.drive": "torque",
    "cosimulation.step": 2.5e-4,
    "effects.motor_inertia": 0.01,
    "controller": [{"kind": "pd", "proportional": 1e3, "derivative": 10.0, "sample_time": 2.5e-4}],
}


def peak() -> float:
    """Most memory so far [GB]; Linux's ``ru_maxrss`` would count the process that started this one too."""
    status = Path("/proc/self/status")
    if not status.exists():
        return 1024e-9 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    line = next(each for each in status.read_text().splitlines() if each.startswith("VmHWM"))
    return 1024e-9 * int(line.split()[1])


def many_scenes(count: int) -> None:
    """Run scenes that differ in payload and duration, and print what grows after the first twenty."""
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.step": 1e-3, "trajectory.dwell": 0.02})
    status, maps, opened = (Path("/proc/self", name) for name in ("status", "maps", "fd"))

    def held() -> tuple[float, int, int]:
        line = next(each for each in status.read_text().splitlines() if each.startswith("VmRSS"))
        return 1.024e-3 * int(line.split()[1]), maps.read_text().count("\n"), len([*opened.iterdir()])

    before, begin = held(), process_time()
    for i in range(20 + count):
        if i == 20:
            before, begin = held(), process_time()
        run(scene.replace({"payload.mass": 1.0 + 5.0 * i / count, "trajectory.duration": 0.4 + 0.2 * i / count}))
    seconds = (process_time() - begin) / count
    memory, mappings, files = (b - a for a, b in zip(before, held(), strict=True))
    print(f"{count} scenes: {1e3 * seconds:.3g} ms each; {memory:+.3g} MB, {mappings:+d} mappings, {files:+d} files")


def main() -> None:
    """Run, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=75.0, help="motion and dwell [s]")
    parser.add_argument("--csv", action="store_true", help="write results.csv too")
    parser.add_argument("--scenes", type=int, help="run so many different scenes instead (Linux)")
    options = parser.parse_args()
    if options.scenes:
        many_scenes(options.scenes)
        return
    scene = load_scene("barnard2012-0.1kg")
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


if __name__ == "__main__":
    main()

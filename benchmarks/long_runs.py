"""The predicted and the measured cost of long runs: a closed loop at 4 kHz; and what many different scenes cost in one process.

python benchmarks/long_runs.py [--seconds 75] [--csv] | --scenes 10000 | --mixed 20000

Scenes that differ in payload and duration share one FMU. With --mixed each run takes one of `MIXED`, which all need FMUs of their
own, more than a process keeps, and between the runs there are builds and sweeps; FLEXFMU_CACHE=/tmp/cache FLEXFMU_CACHE_LIMIT=100 gives it a small cache of its own, which fills.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from flexfmu import build, load_scene, run, sweep
from flexfmu.cosim.engine.errors import CostWarning
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.fmu_build.cache import cached_files

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


MIXED = [
    {"effects.proximal_bending": bending, "effects.distal_axial": axial, "effects.basis": basis, **drive}
    for bending in (1, 2, 3)
    for axial in (0, 1, 2)
    for basis in ("assumed-modes", "craig-bampton")
    for drive in ({}, {"cosimulation.drive": "torque", "effects.motor_inertia": 0.01})
] + [{"effects.beam": "timoshenko", "mechanism.distal.length": 0.38 + 0.002 * i} for i in range(8)]
"""Changes to a scene, each with an FMU of its own."""


HELD = "{:+.3g} MB, {:+.0f} mappings, {:+.0f} open files, {:+.0f} temporary ones, {:+.3g} MB of cache"


def held(temporary: Path) -> list[float]:
    """Memory [MB], mappings, open files, temporary files and folders, and size of the cache [MB] (Linux)."""
    status, maps, opened = (Path("/proc/self", name) for name in ("status", "maps", "fd"))
    line = next(each for each in status.read_text().splitlines() if each.startswith("VmRSS"))
    mappings, cache = maps.read_text().count("\n"), sum(each.size for each in cached_files())
    return [
        1.024e-3 * int(line.split()[1]),
        mappings,
        len([*opened.iterdir()]),
        len([*temporary.rglob("*")]),
        1e-6 * cache,
    ]


def many_scenes(count: int, mixed: Sequence[Mapping[str, Any]]) -> None:
    """Run scenes that differ in payload and duration, or in all that ``mixed`` says, and print what grows after the first ones."""
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.step": 1e-3, "trajectory.dwell": 0.02})
    first, every = 20 + 2 * len(mixed), max(count // 10, 1)
    with tempfile.TemporaryDirectory() as folder:
        tempfile.tempdir, before, begin = folder, [0.0], 0.0
        for i in range(first + count):
            if i == first:
                before, begin = held(Path(folder)), process_time()
            changes = {"payload.mass": 1.0 + 5.0 * i / count, "trajectory.duration": 0.4 + 0.2 * i / count}
            one = scene.replace(changes | (mixed[i % len(mixed)] if mixed else {}))
            run(one)
            if mixed and i % 20 == 0:
                build(one, Path(folder, f"{i % 3}.fmu"))
            if mixed and i % 200 == 0:
                sweep(
                    one,
                    {"payload.mass": [1.0, 2.0, 3.0]},
                    processes=1 + i // 200 % 2,
                    out=Path(folder, "sweep"),
                    restart=True,
                )
            done = i + 1 - first
            if done > 0 and done % every == 0:
                seconds = (process_time() - begin) / done
                more = [b - a for a, b in zip(before, held(Path(folder)), strict=True)]
                print(f"{done} scenes: {1e3 * seconds:.3g} ms each; " + HELD.format(*more), flush=True)


def main() -> None:
    """Run, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=75.0, help="motion and dwell [s]")
    parser.add_argument("--csv", action="store_true", help="write results.csv too")
    parser.add_argument("--scenes", type=int, help="run so many scenes of other payloads and durations instead (Linux)")
    parser.add_argument("--mixed", type=int, help="the same with scenes that need different FMUs, builds and sweeps")
    options = parser.parse_args()
    if options.scenes or options.mixed:
        many_scenes(options.mixed or options.scenes, MIXED if options.mixed else ())
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

"""The cost of a run in a child process: its start, and each recorded instant, in processor time of both processes.

python benchmarks/isolation_cost.py
"""

from __future__ import annotations

import resource

import numpy as np

from flexfmu import load_scene
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.many.prepared_scene import PreparedScene

SCENE = load_scene("barnard2012-6kg").replace(
    {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "controller": [{"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0, "sample_time": 1e-3}],
    }
)

DWELLS, REPEAT, FASTEST = (0.0, 4.0), 12, 4
"""Two lengths of runs [s]; how often each is repeated, and how many of the fastest count."""


def processor_time() -> float:
    """Of this process and its children that have ended [s]."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def measure(record: Selection) -> None:
    """Print the cost with these signals."""
    times: dict[tuple[float, bool], list[float]] = {}
    instants = {}
    for _ in range(REPEAT):
        for dwell in DWELLS:
            for isolate in (False, True):
                scene = SCENE.replace({"trajectory.dwell": dwell})
                prepared = PreparedScene(scene, isolate=isolate, record=record)
                before = processor_time()
                run = prepared.run()
                times.setdefault((dwell, isolate), []).append(processor_time() - before)
                instants[dwell] = run.recording.time.size
    best = {key: float(np.sort(values)[:FASTEST].mean()) for key, values in times.items()}
    each = [
        (best[DWELLS[1], i] - best[DWELLS[0], i]) / (instants[DWELLS[1]] - instants[DWELLS[0]]) for i in (False, True)
    ]
    start = best[DWELLS[0], True] - best[DWELLS[0], False]
    what = "everything" if record.names is None else ", ".join(record.names)
    print(
        f"recording {what}: start {1e3 * start:.0f} ms; an instant {1e6 * each[0]:.2f} us here, {1e6 * each[1]:.2f} us isolated"
    )


if __name__ == "__main__":
    measure(EVERYTHING)
    measure(Selection(["joint1.position"], 0))

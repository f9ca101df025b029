"""The cost of an error of 1e-3 here and with Exudyn (pip install flexfmu[peers]): the same robot, the same damping.

Errors are the largest distance from each program's own converged path, relative to the largest elastic deviation: models differ, and
this is about time. Times are processor times of a run, without building and loading; `chosen` is the scene's own set of
effects, `all` is what Exudyn has, too: every link bends and stretches, with foreshortening.

    python benchmarks/exudyn_time.py
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the comparison with other formulations

from formulations import SHAPES

from flexfmu import load_scene
from flexfmu.benchmarks.peers.exudyn_peer import simulate_exudyn
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.timing import fastest
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.studies.workprec.trial import SAMPLING, SceneUnderTest, completed, subject_of
from flexfmu.model.scene.schema import Scene

SCENES = ("barnard2012-6kg", "barnard2012-0.1kg")
DAMPINGS = {"none": {"kind": "none"}, "0.2 ms x stiffness": {"kind": "stiffness", "time": 2e-4}}
WANTED = 1e-3

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
CONVERGED_TOLERANCE = 1e-10

STEPS = tuple(1e-3 / count for count in (1, 2, 4, 5, 8, 10, 16, 20, 32, 40))
"""Of Exudyn [s]."""

ELEMENTS = 2
"""A link: to 1e-4 the path of eight, with damping; with more, Exudyn takes longer."""

CONVERGED_STEP = 1e-3 / 80


@dataclass(frozen=True)
class Reached:
    """The fastest setting within the error: its name, its processor time [s], its error."""

    setting: str
    time: float
    error: float


def main() -> None:
    """Measure and print."""
    print("| scene | damping | ours, chosen | ours, all | Exudyn | times, chosen | times, all |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in SCENES:
        for label, damping in DAMPINGS.items():
            scene = load_scene(name).replace({"effects.damping": damping})
            every = scene.replace(SHAPES | {"effects.foreshortening": True})
            theirs, chosen, full = exudyn(every), ours(scene), ours(every)
            cells = [f"{1e3 * each.time:.3g} ms ({each.setting}, {each.error:.1e})" for each in (chosen, full, theirs)]
            # where Exudyn's shortest step isn't enough it would take longer still
            more = ">" if theirs.error > WANTED else ""
            ratios = [f"{more}{theirs.time / each.time:.0f}" for each in (chosen, full)]
            print("| " + " | ".join([name, label, *cells, *ratios]) + " |", flush=True)


def ours(scene: Scene) -> Reached:
    """Our co-simulation, all values recorded at 1 kHz, by the fastest tolerance that is good enough."""

    def prepare(tolerance: float) -> PreparedScene:
        return PreparedScene(scene, communication_step=SAMPLING, tolerance=tolerance, record=Selection(None, order=0))

    runs = {each: prepare(each) for each in TOLERANCES}
    subject = subject_of(scene)
    converged = prepare(CONVERGED_TOLERANCE)
    exact = subject.positions(completed(converged.run()))
    found = []
    for tolerance, prepared in runs.items():
        error = relative(subject, subject.positions(completed(prepared.run())), exact)
        if error <= WANTED:
            found.append(Reached(f"{tolerance:.0e}", fastest(prepared.run), error))
    return min(found, key=lambda each: each.time)


def exudyn(scene: Scene) -> Reached:
    """Its longest step that is good enough, or the shortest of `STEPS`."""
    subject = subject_of(scene)

    def run(step: float) -> tuple[RealArray, float]:
        found = simulate_exudyn(scene, subject.motion, subject.instants, step, ELEMENTS)
        return found.position, found.time

    exact = run(CONVERGED_STEP)[0]
    for step in STEPS:
        position, time = run(step)
        error = relative(subject, position, exact)
        if error <= WANTED:
            break
    return Reached(f"{1e3 * step:.3g} ms", min(time, run(step)[1]), error)


def relative(subject: SceneUnderTest, position: RealArray, exact: RealArray) -> float:
    """Largest distance of two paths (N, 2) relative to the largest elastic deviation."""
    rigid = subject.motion.task.evaluate(subject.instants, 0)[0]
    distance, scale = (np.linalg.norm(each - exact, axis=1).max() for each in (position, rigid))
    return float(distance / scale)


if __name__ == "__main__":
    main()

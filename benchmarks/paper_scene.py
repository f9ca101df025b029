"""The scenes of the benchmarks and their timing. Not a script of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from time import process_time

from flexfmu import load_scene
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulator import Simulator
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Slave
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.studies.workprec.trial import completed
from flexfmu.model.scene.schema import Scene

SCENE = load_scene("barnard2012-6kg")
SCENES = {12: SCENE, 6: SCENE.replace({"effects.proximal_bending": 2, "effects.distal_axial": 1})}
"""Degrees of freedom → scene."""

Timed = Callable[[], float]
"""An action that returns its processor time [s].

A run takes place in one thread, so on an idle machine this is its duration; on a busy one it is still the cost.
"""


def timed(action: Callable[[], object]) -> Timed:
    """The action, timed."""

    def run() -> float:
        started = process_time()
        action()
        return process_time() - started

    return run


def whole_run(
    scene: Scene, step: float, tolerance: float, fmu_path: Path | None = None, record: Selection = EVERYTHING
) -> Timed:
    """A co-simulation from its first step to its complete recording, all columns made; planning, building and loading are done
    before."""
    prepared = PreparedScene(scene, communication_step=step, tolerance=tolerance, fmu_path=fmu_path, record=record)
    completed(prepared.run())
    return timed(partial(run_and_read, prepared))


def run_and_read(prepared: PreparedScene) -> None:
    """A run and all of its columns, which are made when they are first asked for."""
    for _ in prepared.run().recording.columns.values():
        pass


def run_with(plant: Slave, step: float, record: Selection = EVERYTHING) -> Timed:
    """A co-simulation of the paper's motion through any plant."""
    motion = plan(SCENE)
    references = TrajectorySlave(motion.joints)
    names = [variable.name for variable in references.variables]
    system = connect([references, plant], [(f"trajectory.{name}", f"{plant.name}.{name}") for name in names])
    simulator = Simulator(system, motion.stop_time, step, record=record)
    result = simulator.run()
    if result.outcome is not Outcome.COMPLETED:
        raise SystemExit(result.message)
    return timed(simulator.run)


IN_A_ROW = 5
"""Repetitions of a run before the next one has its turn, as in a loop over variants: the first finds caches filled by others."""


def best_times(runs: Sequence[Timed], repeat: int) -> list[float]:
    """Least time of each run in so many rounds of `IN_A_ROW`; in rounds, because a machine is faster at one moment than at
    another."""
    rounds = [[min(run() for _ in range(IN_A_ROW)) for run in runs] for _ in range(repeat)]
    return [min(times) for times in zip(*rounds, strict=True)]

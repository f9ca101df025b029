"""The scene that the benchmarks run, and how they time it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import process_time

from flexfmu.cosim.master import Outcome, simulate
from flexfmu.cosim.planning import plan
from flexfmu.cosim.slave import Slave
from flexfmu.cosim.system import connect
from flexfmu.cosim.trajectory_slave import TrajectorySlave
from flexfmu.model.scene_file import load_scene

SCENE = load_scene("barnard2012-6kg")


def timed_run(plant: Slave, step: float, tolerance: float) -> Callable[[], float]:
    """A function that runs the scene through a plant and gives the processor time [s] that it took.

    A run takes place in one thread, so on an idle machine this is its duration; on a busy one it still is what it costs.
    """
    motion = plan(SCENE)
    references = TrajectorySlave(motion.joints)
    names = [variable.name for variable in references.variables]
    system = connect([references, plant], [(f"trajectory.{name}", f"{plant.name}.{name}") for name in names])

    def run() -> float:
        started = process_time()
        result = simulate(system, motion.stop_time, step, tolerance=tolerance)
        if result.outcome is not Outcome.COMPLETED:
            raise SystemExit(result.message)
        return process_time() - started

    return run


def best_times(runs: Sequence[Callable[[], float]], repeat: int) -> list[float]:
    """Least time of each run in so many rounds; in rounds, because a machine is faster at one moment than at another."""
    rounds = [[run() for run in runs] for _ in range(repeat)]
    return [min(times) for times in zip(*rounds, strict=True)]

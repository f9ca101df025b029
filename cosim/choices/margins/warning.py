"""A warning for runs whose loop is unstable, or nearly."""

from __future__ import annotations

from flexfmu.cosim.choices.margins.linear_loop import LinearLoop
from flexfmu.cosim.choices.margins.margins import critical_gain, is_stable
from flexfmu.cosim.choices.margins.scene_loop import WiredLoop
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.system import PLANT
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.trajectories.errors import TrajectoryError

NEAR = 1.1
"""Factor of the torques, up or down, within which a loop must be stable to be far enough from instability."""


def stability_warning(run: Run) -> str | None:
    """What there is to say of a run's loop about standstill at the end of its motion; None for a loop that is far from instability,
    for none, and for one that can't be linearised."""
    scene = run.scene
    if scene.cosimulation.drive != "torque" or not scene.controller:
        return None
    try:
        loop = loop_of(scene, run.plan)
        # a function in C that has crashed a run in its own process must not crash this one
        if not run.completed and any(getattr(each, "has_foreign_code", False) for each in loop.controllers):
            return None
        x, y = run.plan.once.task.evaluate([run.plan.once.duration], 0, "left")[0, 0].tolist()
        linear, _ = WiredLoop(scene, loop, FmuSlave(run.fmu_path, PLANT, {}, None)).at((x, y))
        return _sentence(linear)
    except (CosimError, SceneError, TrajectoryError, EquilibriumError, ValueError):
        return None


def _sentence(loop: LinearLoop) -> str | None:
    where = "about the end of the motion"
    if not is_stable(loop):
        return f"the loop is unstable {where}; `flexfmu margins` tells more"
    for factor, way in ((NEAR, "larger"), (1.0 / NEAR, "smaller")):
        if not is_stable(loop, factor):
            percent = 100.0 * abs(critical_gain(loop, factor) - 1.0)
            return f"the loop is close to instability {where}: with torques {percent:.2g} % {way} it is unstable; see `flexfmu margins`"
    return None

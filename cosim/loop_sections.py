"""From the sections of a scene file to controllers, shapers and imperfections."""

from __future__ import annotations

from collections.abc import Mapping

from flexfmu.cosim.loop import Loop, Names, make_loop
from flexfmu.cosim.planning import MotionPlan, plan
from flexfmu.model.scene import Scene


def loop_of(scene: Scene, motion: MotionPlan | None = None) -> Loop:
    """The loop that a scene's sections describe.

    Args:
        scene: the scene.
        motion: a motion instead of the scene's own with its shapers.

    Raises:
        InputError: a slave can't be made or wired.
        TrajectoryError: the motion is not feasible, or can't be shaped.
    """
    shapers = scene.shaper if motion is None else ()
    planned = plan(scene) if motion is None else motion
    if not (scene.controller or shapers or scene.imperfection):
        return Loop(planned, planned.joints)
    from flexfmu.cosim.loop_builders import LoopBuilder

    names = Names()
    builder = LoopBuilder(scene, planned, names)
    return make_loop(
        planned,
        [builder.controller(each) for each in scene.controller],
        [builder.shaper(each) for each in shapers],
        [builder.imperfection(each) for each in scene.imperfection],
        builder.connect,
        names,
    )


def holding_torques(scene: Scene) -> Mapping[str, float]:
    """Torques that hold the start pose of a scene that is driven by torques; nothing for one driven by motion."""
    if scene.cosimulation.drive != "torque":
        return {}
    from flexfmu.model.assembly import motor_angles
    from flexfmu.model.statics import static_equilibrium

    torque = static_equilibrium(scene, motor_angles(scene.mechanism, scene.trajectory.start)).torque
    return {f"joint{joint}.torque": float(value) for joint, value in enumerate(torque, start=1)}

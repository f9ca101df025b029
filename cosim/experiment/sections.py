"""From the sections of a scene file to controllers, shapers and imperfections."""

from __future__ import annotations

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.cycles import repeated
from flexfmu.cosim.experiment.loop import Loop, close_loop, shape
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.experiment.user_slaves import Names
from flexfmu.model.scene.controllers import LearningSection
from flexfmu.model.scene.schema import Scene


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
    from flexfmu.cosim.experiment.builders import LoopBuilder

    names = Names()
    builder = LoopBuilder(scene, planned, names)
    course = shape(planned, [builder.shaper(each) for each in shapers], names, lambda shaped: _repeated(scene, shaped))
    controllers = [builder.controller(each, course.motion) for each in scene.controller]
    imperfections = [builder.imperfection(each) for each in scene.imperfection]
    return close_loop(course, controllers, imperfections, builder.connect, names)


def _repeated(scene: Scene, motion: MotionPlan) -> MotionPlan:
    """The motion, repeated where a controller learns.

    Raises:
        InputError: controllers learn over different numbers of cycles, or at different sample times.
    """
    learning = [each for each in scene.controller if isinstance(each, LearningSection)]
    if not learning or motion.repetition is not None:
        return motion
    first = learning[0]
    for key in ("cycles", "sample_time"):
        values = [getattr(each, key) for each in learning]
        if len(set(values)) > 1:
            raise InputError(
                f"all learning controllers of a scene share one motion: give them the same `{key}`, got {values}"
            )
    return repeated(motion, first.cycles, first.sample_time)

"""A few lines for users: put controllers, shapers and imperfections between a scene's motion and its robot, and run it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Unpack

from flexfmu.cosim.experiment.loop import make_loop
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.experiment.prepared_scene import Options, Run, run_scene
from flexfmu.model.scene.schema import Scene


def run_loop(
    scene: Scene,
    controllers: Iterable[Any] = (),
    shapers: Iterable[Any] = (),
    imperfections: Iterable[Any] = (),
    connect: Mapping[str, str] | None = None,
    motion: MotionPlan | None = None,
    **options: Unpack[Options],
) -> Run:
    """Run a scene with these instead of its own sections.

    Anything may be a `SymbolicBlock` (what `flexfmu.cosim.control.controllers` and `flexfmu.cosim.control.imperfections` return), a slave
    of your own, a `control.StateSpace` or `control.TransferFunction`, or the path of an FMU.

    Example:
        ``run_loop(scene, controllers=[pd(2e4, 200.0, sample_time=1e-3)], imperfections=[encoder(2**17, sample_time=1e-3)])``

    Args:
        scene: the scene; with controllers, one that is driven by torques.
        controllers: what calculates torques from references and measurements; equal names are connected.
        shapers: `flexfmu.cosim.control.shapers.Shaper`, an `ImpulseSequence` for the joint references, or what else the references
            shall pass.
        imperfections: what signals pass on their way, in this order, or `flexfmu.cosim.control.imperfections.payload_error.PayloadError`.
        connect: ``slave.input`` → ``slave.output`` or name of a signal, beyond equal names.
        motion: a motion instead of the scene's own, planned from the same scene.
        options: as for `flexfmu.cosim.experiment.prepared_scene.run_scene`.

    Raises:
        TrajectoryError: the motion is not feasible, or can't be shaped.
        InputError: something can't be a slave, or the slaves can't be wired.
        BuildError: the FMU can't be built.
    """
    planned = plan(scene) if motion is None else motion
    return run_scene(scene, loop=make_loop(planned, controllers, shapers, imperfections, connect), **options)

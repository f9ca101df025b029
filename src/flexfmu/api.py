"""The functions of `import flexfmu`. Each is a short way to the function that does the work, and names it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.cosim.choices.effects.choice import resolved
from flexfmu.cosim.engine.master.simulation_loop import Progress
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.planning import plan as plan_motion
from flexfmu.cosim.experiment.prepared_scene import run_scene
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.reports.modes_table import ModalPose, modes_along_path
from flexfmu.fmu_build.naming import Naming
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    import control

SceneSource = Scene | Path | str
"""A scene, the path of a scene file, or the name of a shipped scene."""


def run(
    scene: SceneSource,
    *,
    communication_step: float | None = None,
    tolerance: float | None = None,
    parameters: Mapping[str, float] | None = None,
    fmu: str | Path | None = None,
    progress: Progress | None = None,
) -> Run:
    """Plan a scene's motion, build its FMU or take it from the cache, and co-simulate motion and dwell.

    The scene's controllers, shapers and imperfections take part. Where it says ``effects = { select = "auto" }``, they are
    chosen first. More is possible with `flexfmu.cosim.experiment.prepared_scene.run_scene`, and with controllers as objects with
    `flexfmu.cosim.experiment.prepared_scene.run_loop`.

    Args:
        scene: a scene, the path of its file, or the name of a shipped one.
        communication_step: [s]; the scene's own when None.
        tolerance: relative tolerance for the FMU; the scene's own when None.
        parameters: FMU parameters that differ from the scene's, in SI units, for example ``{"payload.mass": 0.1}``.
        fmu: path of an FMU of a scene with the same effects, instead of building one; its parameters are set from this scene.
        progress: called now and then with the simulated fraction, 0..1.

    Returns:
        The run: ``run.recording`` holds the signals, with units; ``run.outcome`` and ``run.message`` say how it ended. When a
        slave fails on the way, the recording holds what there was until then. `measure_run` gives its metrics.

    Raises:
        SceneError: no such scene, or a key or value that can't be right.
        TrajectoryError: the motion is not feasible, or can't be shaped.
        InputError: the FMU can't be loaded or lacks a variable, a parameter doesn't exist or is out of range, or the slaves
            can't be wired.
        BuildError: the FMU can't be built (no compiler, for example).
        ResultsError: effects are to be chosen, and a run that verifies the choice failed.
    """
    return run_scene(
        resolved(_scene(scene)),
        communication_step=communication_step,
        tolerance=tolerance,
        parameters=parameters,
        fmu_path=None if fmu is None else Path(fmu),
        progress=progress,
    )


def build(
    scene: SceneSource,
    output: str | Path | None = None,
    *,
    platforms: Iterable[str] | None = None,
    naming: Naming = "structured",
    enumerations: bool = False,
) -> Path:
    """Build the FMI 2.0 FMU of a scene, for co-simulation and model exchange, or take it from the cache.

    As `flexfmu.cosim.experiment.scene_build.build_scene`, which also returns GUID, size and time.

    Args:
        scene: a scene, the path of its file, or the name of a shipped one.
        output: file to write; None leaves the FMU in the cache.
        platforms: of linux64, win64, darwin64, aarch64-linux, aarch64-darwin; None for this machine's.
        naming: of the variables, ``structured`` (``link11.bending[1]``) or ``flat`` (``link11_bending_1``).
        enumerations: whether the choices ``initial`` and ``integrator`` are FMI enumerations instead of Integers.

    Returns:
        The path of the FMU.

    Raises:
        SceneError: no such scene, or a key or value that can't be right.
        BuildError: an unknown platform, no compiler, a compiler's error, or a file that can't be written.
        TrajectoryError, ResultsError: effects are to be chosen (``select = "auto"``), and the motion is not feasible, or a run
            that verifies the choice failed.
    """
    target = None if output is None else Path(output)
    chosen = resolved(_scene(scene))
    return build_scene(chosen, output=target, platforms=platforms, naming=naming, enumerations=enumerations).path


def plan(scene: SceneSource) -> MotionPlan:
    """Plan a scene's motion and check it along the whole path; its shapers are left out, in a run they act on it.

    As `flexfmu.cosim.experiment.planning.plan`.

    Args:
        scene: a scene, the path of its file, or the name of a shipped one.

    Returns:
        The plan: ``plan.task`` is the end effector's trajectory in x, y [m], ``plan.joints`` that of the motors in q11, q21
        [rad], each with derivatives of any order: ``plan.joints.evaluate(time, order=2)``.

    Raises:
        SceneError: no such scene, or a key or value that can't be right.
        TrajectoryError: the path is not feasible, leaves the workspace or comes too close to a singularity.
    """
    return plan_motion(_scene(scene))


def modes(scene: SceneSource, poses: int = 11) -> list[ModalPose]:
    """Natural frequencies along a scene's path, motors locked, undamped, about the static equilibrium.

    As `flexfmu.cosim.reports.modes_table.modes_along_path`.

    Args:
        scene: a scene, the path of its file, or the name of a shipped one.
        poses: how many, equally spaced along the path, its start, middle and end among them: odd, at least 3.

    Returns:
        For each pose its place ``s`` along the path (0..1), the end effector's ``x``, ``y`` [m] and the motors' ``q11``,
        ``q21`` [rad] of the rigid robot, and ``frequencies`` [Hz], ascending; none for a rigid robot.

    Raises:
        SceneError: no such scene, or a key or value that can't be right.
        TrajectoryError: the path is not feasible, leaves the workspace or comes too close to a singularity.
        InputError: ``poses`` is even or too small.
        EquilibriumError: the robot has no stable static equilibrium at a pose.
        BuildError, ResultsError: effects are to be chosen (``select = "auto"``), and a run that verifies the choice failed.
    """
    return modes_along_path(plan_motion(resolved(_scene(scene))), poses)


def linearize(
    scene: SceneSource, position: tuple[float, float], outputs: Sequence[str] | None = None
) -> control.StateSpace:
    """The robot driven by torques, linearised about its static equilibrium at a pose, for python-control.

    As `flexfmu.model.linear.linearize`: in deviations from the equilibrium. States are the coordinates [q_a, q_e] and their
    rates, inputs ``joint1_torque``, ``joint2_torque`` [N.m], ``force_x``, ``force_y`` [N]. Labels and units are those of the
    FMU's variables, with underscores for dots.

    Args:
        scene: a scene, the path of its file, or the name of a shipped one; its drive doesn't matter.
        position: x, y of the rigid end effector [m].
        outputs: names of the outputs, for example ``["joint1.position"]``; all of the FMU's when None.

    Raises:
        SceneError: no such scene, or a key or value that can't be right.
        ImportError: python-control isn't installed (``pip install flexfmu[control]``).
        ValueError: an output is unknown, or the position is out of reach.
        EquilibriumError: there is no equilibrium.
        TrajectoryError, BuildError, ResultsError: effects are to be chosen (``select = "auto"``), and the motion is not feasible,
            or a run that verifies the choice failed.
    """
    from flexfmu.model.linear import linearize as linearize_scene  # needs CasADi, which `run` does without

    return linearize_scene(resolved(_scene(scene)), position, outputs)


def _scene(source: SceneSource) -> Scene:
    """The scene itself, or what its file says."""
    if isinstance(source, Scene):
        return source
    if isinstance(source, str | Path):
        return load_scene(source)
    raise TypeError(
        f"expected a Scene, the path of a scene file or the name of a shipped scene, got {type(source).__name__}: {source!r}"
    )

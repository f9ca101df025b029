"""One experiment: a scene's motion through its FMU, from the plan to the recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from flexfmu.cosim.errors import InputError
from flexfmu.cosim.fmu_file import open_fmu
from flexfmu.cosim.fmu_slave import FmuSlave
from flexfmu.cosim.fmu_variables import Value, parameter_names
from flexfmu.cosim.master import Outcome, Progress, simulate
from flexfmu.cosim.planning import MotionPlan, plan
from flexfmu.cosim.results import Recording
from flexfmu.cosim.rigid_motion import with_rigid_motion
from flexfmu.cosim.scene_parameters import parameters_for
from flexfmu.cosim.system import connect
from flexfmu.cosim.trajectory_slave import HERMITE_ORDER, TrajectorySlave
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.model.scene import Scene

PLANT, REFERENCES = "plant", "trajectory"
"""Names of the slaves."""


@dataclass(frozen=True)
class Timing:
    """Wall times [s] of planning, building (or finding) the FMU, loading it, and simulating."""

    plan: float
    build: float
    load: float
    simulate: float


@dataclass(frozen=True)
class Health:
    """How the FMU fared.

    Attributes:
        statistics: the FMU's Integer variables ``statistics.*`` at the end, without that prefix: steps, rejections,
            evaluations, iterations, factorisations; empty for an FMU without them.
        messages: what the FMU logged, in its own words.
    """

    statistics: Mapping[str, int]
    messages: tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """A simulated scene.

    Attributes:
        plan: the scene and its planned motion.
        recording: every output of the FMU with first and second derivatives, the joint references that drove it
            (``joint1.reference.position`` and so on) and the rigid end-effector motion
            (``end_effector.reference.position.x`` and so on: position, velocity, acceleration), over motion and dwell,
            up to where the run came. The first instant appears twice (standstill, motion), so does every breakpoint.
        outcome: how the run ended; `Outcome.COMPLETED` when all went well.
        message: what happened, in one line.
        fmu_path: the FMU that was simulated.
        communication_step: communication step [s].
        tolerance: relative tolerance passed to the FMU.
        input_order: degree of the input polynomials.
        health: statistics and messages of the FMU.
        timing: wall times.
    """

    plan: MotionPlan
    recording: Recording
    outcome: Outcome
    message: str
    fmu_path: Path
    communication_step: float
    tolerance: float
    input_order: int
    health: Health
    timing: Timing

    @property
    def scene(self) -> Scene:
        """The scene that was simulated."""
        return self.plan.scene

    @property
    def completed(self) -> bool:
        """Whether the run reached its stop time."""
        return self.outcome is Outcome.COMPLETED


def run_scene(
    scene: Scene,
    *,
    communication_step: float | None = None,
    tolerance: float | None = None,
    input_order: int | None = None,
    fmu_path: Path | None = None,
    progress: Progress | None = None,
    parameters: Mapping[str, float] | None = None,
    initial: str | None = None,
    motion: MotionPlan | None = None,
) -> Run:
    """Plan the scene's motion, build its FMU or take it from the cache, and co-simulate motion and dwell.

    Args:
        scene: what to simulate.
        communication_step: communication step [s]; the scene's own when None.
        tolerance: relative tolerance for the FMU; the scene's own when None.
        input_order: degree of the input polynomials, 0 (values only) to 9; None for the highest that the FMU states.
        fmu_path: an FMU to use as it is instead of building one, made from a scene with the same effects; its
            parameters are set from this scene.
        progress: called now and then with the simulated fraction, 0..1.
        parameters: FMU parameters that differ from the scene's, for example ``{"payload.mass": 0.1}``.
        initial: ``static`` or ``undeformed``; the scene's own when None.
        motion: a motion to run instead of the scene's own, a shaped one for example, planned from the same scene.

    Returns:
        The run; when the FMU fails on the way, with all that was recorded until then and the outcome.

    Raises:
        TrajectoryError: the motion is not feasible.
        InputError: the scene is driven by torques, which nobody sets here; the FMU can't be loaded or lacks a variable;
            a parameter doesn't exist or is out of range.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    _check_drive(scene)
    planning = perf_counter()
    motion = plan(scene) if motion is None else motion
    building = perf_counter()
    path = fmu_path if fmu_path is not None else build_scene(scene).path
    loading = perf_counter()
    plant = FmuSlave(path, PLANT, _parameters(scene, path, initial, parameters or {}), input_order)
    order = min(plant.max_input_order, HERMITE_ORDER) if input_order is None else input_order
    references = TrajectorySlave(motion.joints, order=order, name=REFERENCES)
    names = [variable.name for variable in references.variables]
    system = connect([references, plant], [(f"{REFERENCES}.{name}", f"{PLANT}.{name}") for name in names])
    step = scene.cosimulation.step if communication_step is None else communication_step
    relative = scene.cosimulation.tolerance if tolerance is None else tolerance
    simulating = perf_counter()
    simulation = simulate(system, motion.stop_time, step, tolerance=relative, progress=progress)
    done = perf_counter()
    return Run(
        plan=motion,
        recording=with_rigid_motion(_plain_names(simulation.recording), motion),
        outcome=simulation.outcome,
        message=simulation.message,
        fmu_path=path,
        communication_step=step,
        tolerance=relative,
        input_order=order,
        health=Health(plant.statistics, plant.messages),
        timing=Timing(building - planning, loading - building, simulating - loading, done - simulating),
    )


def _check_drive(scene: Scene) -> None:
    """The planned motion is all that drives a scene."""
    if scene.cosimulation.drive != "motion":
        raise InputError(
            f"`cosimulation.drive` = {scene.cosimulation.drive!r}: a scene is run by its motion alone; use 'motion', or "
            f"build the FMU and set its torques from a script (scene {scene.name})"
        )


def _parameters(scene: Scene, path: Path, initial: str | None, changes: Mapping[str, float]) -> dict[str, Value]:
    """All parameters that the FMU has, from the scene, but for the changes."""
    available = parameter_names(open_fmu(path).description)
    start = {"initial": initial or scene.cosimulation.initial}
    return {**parameters_for(scene, available), **start, **changes}


def _plain_names(recording: Recording) -> Recording:
    """Without the slaves' names: the variables of both have different names."""
    return Recording(recording.time, {name.partition(".")[2]: column for name, column in recording.columns.items()})

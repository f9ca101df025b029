"""One experiment: a scene's motion through its FMU, from the plan to the recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TypedDict

from flexfmu.cosim.coupling import coupling_of
from flexfmu.cosim.delays import SignalDelay
from flexfmu.cosim.loop import Loop
from flexfmu.cosim.loop_recording import SlaveFacts, plain_names, slave_facts, with_constants
from flexfmu.cosim.loop_sections import loop_of
from flexfmu.cosim.master import Outcome, Progress, simulate
from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.results import Recording
from flexfmu.cosim.rigid_motion import with_rigid_motion
from flexfmu.cosim.scene_parameters import scene_with_parameters
from flexfmu.cosim.scene_system import PLANT, REFERENCES, SceneSystem, scene_system
from flexfmu.cosim.system import connect
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.model.scene import Scene


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
        recording: every output of the FMU with first and second derivatives, what acted on it (torques, or joint
            references ``joint1.reference.position`` and so on) and the rigid end-effector motion
            (``end_effector.reference.position.x`` and so on: position, velocity, acceleration), over motion and dwell,
            up to where the run came; what other slaves put out as ``slave.variable``. The first instant appears twice
            (standstill, motion), so does every breakpoint and every sample instant.
        outcome: how the run ended; `Outcome.COMPLETED` when all went well.
        message: what happened, in one line.
        fmu_path: the FMU that was simulated.
        communication_step: communication step [s].
        tolerance: relative tolerance passed to the FMU.
        input_order: degree of the input polynomials.
        health: statistics and messages of the FMU.
        timing: wall times.
        slaves: all slaves of the system.
        delays: for each connection how late its signals arrive.
        parameters: parameters of the robot that differ from the scene's.
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
    slaves: tuple[SlaveFacts, ...] = ()
    delays: tuple[SignalDelay, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def scene(self) -> Scene:
        """The scene that was simulated."""
        return self.plan.scene

    @property
    def robot(self) -> Scene:
        """The scene with the parameters that the robot had."""
        return scene_with_parameters(self.scene, self.parameters)

    @property
    def completed(self) -> bool:
        """Whether the run reached its stop time."""
        return self.outcome is Outcome.COMPLETED


class Options(TypedDict, total=False):
    """Keywords of `run_scene` that have nothing to do with what stands between motion and robot."""

    communication_step: float | None
    tolerance: float | None
    input_order: int | None
    fmu_path: Path | None
    progress: Progress | None
    parameters: Mapping[str, float] | None
    initial: str | None


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
    loop: Loop | None = None,
) -> Run:
    """Plan the scene's motion, build its FMU or take it from the cache, and co-simulate motion and dwell.

    The scene's controllers, shapers and imperfections take part. A robot that is driven by torques and has no controller
    gets the torques that hold its start pose.

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
        motion: a motion to run instead of the scene's own with its shapers, planned from the same scene.
        loop: what stands between motion and robot, instead of the scene's own sections; see
            `flexfmu.cosim.closed_loop.run_loop`.

    Returns:
        The run; when a slave fails on the way, with all that was recorded until then and the outcome.

    Raises:
        TrajectoryError: the motion is not feasible, or can't be shaped.
        InputError: an FMU can't be loaded or lacks a variable, a parameter doesn't exist or is out of range, or the
            slaves can't be wired.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    planning = perf_counter()
    loop = loop_of(scene, motion) if loop is None else loop
    building = perf_counter()
    path = fmu_path if fmu_path is not None else build_scene(scene).path
    loading = perf_counter()
    parts = scene_system(scene, loop, path, parameters=parameters, initial=initial, input_order=input_order)
    coupling = coupling_of(scene.cosimulation)
    system = connect(parts.slaves, parts.wiring.connections, loops=coupling.loops)
    step = scene.cosimulation.step if communication_step is None else communication_step
    relative = scene.cosimulation.tolerance if tolerance is None else tolerance
    simulating = perf_counter()
    simulation = simulate(
        system,
        loop.motion.stop_time,
        step,
        tolerance=relative,
        progress=progress,
        algorithm=coupling.algorithm,
        step_control=coupling.step_control,
    )
    done = perf_counter()
    return Run(
        plan=loop.motion,
        recording=_recording(simulation.recording, parts, loop.motion),
        outcome=simulation.outcome,
        message=simulation.message,
        fmu_path=path,
        communication_step=step,
        tolerance=relative,
        input_order=parts.references.announced_order,
        health=Health(parts.plant.statistics, parts.plant.messages),
        timing=Timing(building - planning, loading - building, simulating - loading, done - simulating),
        slaves=slave_facts(parts.slaves),
        delays=simulation.delays,
        parameters=parts.changes,
    )


def _recording(recorded: Recording, parts: SceneSystem, motion: MotionPlan) -> Recording:
    """What was recorded, with short names, the torques that nothing feeds, and the rigid motion."""
    recording = plain_names(recorded, PLANT, REFERENCES, parts.wiring.feeding)
    return with_rigid_motion(with_constants(recording, parts.plant, parts.constants), motion)

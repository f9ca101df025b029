"""Runs a scene: planned motion → FMU → connected system → simulation → recording."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypedDict, Unpack

from flexfmu.cosim.engine.errors import InputError, LoopWarning
from flexfmu.cosim.engine.master.delays import SignalDelay
from flexfmu.cosim.engine.master.isolation import isolation
from flexfmu.cosim.engine.master.master import Progress
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation
from flexfmu.cosim.engine.master.simulator import Simulator
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.convergence import companion_share, companion_step
from flexfmu.cosim.experiment.divergence import divergence
from flexfmu.cosim.experiment.loop import Loop, make_loop
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.experiment.recorded_instants import RecordedInstants
from flexfmu.cosim.experiment.recording import VELOCITIES, RigidMotion, SceneRecording, slave_facts
from flexfmu.cosim.experiment.run_size import check_size, check_step, recorded_bytes
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Companion, Health, RestingRobot, RestPositions, Run, Timing
from flexfmu.cosim.experiment.system import PLANT, TORQUES, coupling_of, scene_system
from flexfmu.cosim.experiment.timing import Stopwatch
from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE
from flexfmu.model.scene.schema import Scene

__all__ = ["Health", "Options", "PreparedScene", "Run", "Timing", "run_loop", "run_scene"]

COMPANION_TOLERANCE = 1e-2
"""Ratio of a companion's tolerance to the run's; 0.1 isn't enough, since errors scatter by a factor of 10."""

COMPANION_COUPLING = 0.1
"""Ratio of the tolerances of step control, which shortens the steps faster."""


KEYS = {
    "(initial = 2)": '(`cosimulation.initial` = "undeformed")',
    "make integrator.step smaller": "make `cosimulation.integrator_step` smaller",
    "a fixed integrator.step": "a fixed `cosimulation.integrator_step`",
    "(joint_friction.kind =": "(`effects.joint_friction.kind` =",
}
"""What the FMU's messages advise, with its own parameters → the same with keys of the scene."""


class Options(TypedDict, total=False):
    """Keywords of `run_scene`, except ``motion`` and ``loop``."""

    communication_step: float | None
    tolerance: float | None
    input_order: int | None
    fmu_path: Path | None
    progress: Progress | None
    parameters: Mapping[str, float] | None
    initial: str | None
    isolate: bool | None
    call_limit: float | None
    record: Selection | None
    accept_size: bool


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
    isolate: bool | None = None,
    call_limit: float | None = None,
    record: Selection | None = None,
    accept_size: bool = False,
) -> Run:
    """Plan the scene's motion, build its FMU or take it from the cache, and co-simulate motion and dwell.

    The system includes the scene's controllers, shapers and imperfections. A robot driven by torques without a controller
    gets constant torques that hold its start pose.

    Args:
        scene: the scene.
        communication_step: communication step [s]; None for the scene's value, or steps chosen from the motion if the
            scene has none.
        tolerance: relative tolerance for the FMU; None for the scene's value.
        input_order: degree of the input polynomials, 0 (values only) to 9; None for the highest that the FMU supports.
        fmu_path: FMU of a scene with the same effects, instead of building one; its parameters are set from this scene.
        progress: called repeatedly with the simulated fraction, 0..1.
        parameters: FMU parameters that differ from the scene's, for example ``{"payload.mass": 0.1}``.
        initial: ``static`` or ``undeformed``; None for the scene's value.
        motion: motion, planned from the same scene, instead of the scene's own motion with its shapers.
        loop: controllers, shapers and imperfections instead of the scene's sections; see `run_loop`.
        isolate: whether to simulate in a child process, so that a slave that crashes, exits or hangs ends only the run
            (Linux only); None for the scene's value. If that is open too, runs with FMUs of other tools or with the
            scene's Python slaves are isolated, but not runs with Python slaves passed as objects, whose changes would be
            lost in the child process.
        call_limit: time limit of one call of a slave in an isolated run [s]; None for the scene's value.
        record: which signals are recorded, how often, and with how many derivatives; None for the scene's keys.
        accept_size: whether to run however large the recording is.

    Returns:
        The run; if a slave fails, with the recording up to then. A completed run whose control loop is unstable says so in
        ``health`` and by a `LoopWarning`.

    Raises:
        TrajectoryError: the motion is not feasible, or can't be shaped.
        InputError: an FMU can't be loaded or lacks a variable, a parameter doesn't exist or is out of range, the
            slaves can't be connected, or the recordings of the run and its companion have more than 2 GB.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    prepared = PreparedScene(
        scene,
        communication_step=communication_step,
        tolerance=tolerance,
        input_order=input_order,
        fmu_path=fmu_path,
        initial=initial,
        motion=motion,
        loop=loop,
        isolate=isolate,
        call_limit=call_limit,
        record=record,
    )
    if not accept_size:
        prepared.check_size()
    run = prepared.run(parameters, progress)
    if run.health.unstable_loop is not None:
        warnings.warn(run.health.unstable_loop, LoopWarning, stacklevel=_callers_level())
    return run


def _callers_level() -> int:
    """How many frames up from the caller of this function the user's code is."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("flexfmu."):
        frame, level = frame.f_back, level + 1
    return level


def run_loop(
    scene: Scene,
    controllers: Iterable[Any] = (),
    shapers: Iterable[Any] = (),
    imperfections: Iterable[Any] = (),
    connect: Mapping[str, str] | None = None,
    motion: MotionPlan | None = None,
    disturbances: Iterable[Any] = (),
    **options: Unpack[Options],
) -> Run:
    """Run a scene with these controllers, shapers and imperfections instead of its own sections.

    Each may be a `SymbolicBlock` (from `flexfmu.cosim.control.controllers` or `flexfmu.cosim.control.imperfections`), a
    slave, a `control.StateSpace` or `control.TransferFunction`, or the path of an FMU.

    Example:
        ``run_loop(scene, controllers=[pd(2e4, 200.0, sample_time=1e-3)], imperfections=[encoder(2**17, sample_time=1e-3)])``

    Args:
        scene: the scene; driven by torques if there are controllers.
        controllers: slaves that calculate torques from references and measurements; equal names are connected.
        shapers: `flexfmu.cosim.control.shapers.Shaper`, an `ImpulseSequence` for the joint references, or slaves in series
            with references.
        imperfections: slaves in series with signals, in this order, or
            `flexfmu.cosim.control.imperfections.payload_error.PayloadError`.
        connect: ``slave.input`` → ``slave.output`` or name of a signal, in addition to equal names.
        motion: motion, planned from the same scene, instead of the scene's own.
        disturbances: blocks of `flexfmu.cosim.control.disturbances` instead of the scene's; the robot's inputs are those for
            the disturbances of the scene.
        options: as for `run_scene`.

    Raises:
        TrajectoryError: the motion is not feasible, or can't be shaped.
        InputError: an argument can't be made a slave, or the slaves can't be connected.
        BuildError: the FMU can't be built.
    """
    if motion is not None:
        given = make_loop(motion, controllers, shapers, imperfections, connect, disturbances=disturbances)
        return run_scene(scene, loop=given, **options)
    from flexfmu.cosim.experiment.cycles import in_cycles

    loop = make_loop(plan(scene), controllers, shapers, imperfections, connect, in_cycles, disturbances)
    return run_scene(scene, loop=loop, **options)


class PreparedScene:
    """A scene that is planned, built, loaded and connected once, for repeated runs with different parameters.

    Example:
        ``prepared = PreparedScene(scene); runs = [prepared.run({"payload.mass": mass}) for mass in masses]``

    Steps chosen from the motion are those of the scene's own parameters; other parameters may shorten some of them.

    Args and errors: as for `run_scene`.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        communication_step: float | None = None,
        tolerance: float | None = None,
        input_order: int | None = None,
        fmu_path: Path | None = None,
        initial: str | None = None,
        motion: MotionPlan | None = None,
        loop: Loop | None = None,
        record: Selection | None = None,
        isolate: bool | None = None,
        call_limit: float | None = None,
    ) -> None:
        if scene.effects.select is not None:
            raise InputError(
                f"scene {scene.name} leaves the choice of effects open: run it with `flexfmu.run`, or choose first, with "
                f"`flexfmu.cosim.design.effects.choice.resolved(scene)`"
            )
        # plan the motion; make controllers, shapers and imperfections
        watch = Stopwatch()
        section = scene.cosimulation
        theirs, self._loop = loop is not None, loop_of(scene, motion) if loop is None else loop
        self._plans = loop is None and motion is None
        self._stop_time = self._loop.motion.stop_time
        planning = watch.lap()
        # build the FMU, or take it from the cache
        self._fmu_path = build_scene(scene).path if fmu_path is None else fmu_path
        building = watch.lap()
        # load the FMU and connect the system
        self._parts = scene_system(scene, self._loop, self._fmu_path, initial=initial, input_order=input_order)
        self._coupling = coupling_of(section)
        self._system = connect(self._parts.slaves, self._parts.wiring.connections, loops=self._coupling.loops)
        # settings: step, tolerance, isolation, recorded signals
        fixed = section.step if communication_step is None else communication_step
        record = Selection(section.record, section.record_order, section.record_step) if record is None else record
        self._instants = RecordedInstants(self._parts, self._loop.motion, fixed, record)
        self._step = section.communication_step if fixed is None else fixed
        check_step(self._step, self._loop.motion.once.duration)
        self._tolerance = section.tolerance if tolerance is None else tolerance
        self._isolate = section.isolate if isolate is None else isolate
        self._call_limit = section.call_limit if call_limit is None else call_limit
        self._isolation = isolation(self._isolate, self._parts.slaves, self._call_limit, theirs=theirs)
        self._recording = SceneRecording(self._parts, RigidMotion(self._loop.motion), self._instants.recorded)
        self._facts = slave_facts(self._parts.slaves)
        self._rests = RestPositions(self._loop.motion, RestingRobot(scene, self._fmu_path))
        # the simulator is made at the first run; a companion has the same arguments
        self._simulator: Simulator | None = None
        self._points: RealArray | None = None
        self._again: Mapping[str, Any] = {
            "scene": scene,
            "fmu_path": self._fmu_path,
            "initial": initial,
            "input_order": input_order,
            "loop": self._loop,
            "record": record,
            "isolate": self._isolate,
            "call_limit": self._call_limit,
        }
        self._times = planning, building, watch.lap()

    def run(self, parameters: Mapping[str, float] | None = None, progress: Progress | None = None) -> Run:
        """Simulate motion and dwell.

        Args:
            parameters: FMU parameters that differ from the scene's in this run, for example ``{"payload.mass": 0.1}``.
            progress: called repeatedly with the simulated fraction, 0..1.

        Returns:
            The run; if a slave fails, with the recording up to then.

        Raises:
            InputError: a parameter doesn't exist or is out of range.
        """
        watch, changes = Stopwatch(), parameters or {}
        simulate = partial(self._simulated, progress=progress)
        if self._instants.is_open:
            # steps for the scene's own parameters first
            self._parts.with_parameters({})
            self._instants.choose(simulate, self._stop_time, self._tolerance)
        parts = self._parts.with_parameters(changes)
        simulation = self._instants.run(simulate, self._tolerance, own=not changes)
        timing = Timing(*self._times, watch.lap())
        # the message of a failed run includes values with suspicious units
        hints = () if simulation.outcome is Outcome.COMPLETED else self._loop.motion.scene.unit_hints
        run = Run(
            plan=self._loop.motion,
            recording=self._recording.of(simulation.recording, parts),
            outcome=simulation.outcome,
            message="; ".join((*hints, _with_keys(simulation.message))),
            fmu_path=self._fmu_path,
            communication_step=self._step,
            tolerance=self._tolerance,
            input_order=parts.references.announced_order,
            health=Health(parts.plant.statistics, parts.plant.messages),
            timing=timing,
            slaves=self._facts,
            delays=self._delays(simulation.delays),
            parameters=parts.changes,
            companion=self._companion(parts.changes),
            rests=self._rests,
        )
        if run.outcome in (Outcome.INTERRUPTED, Outcome.COUPLING_UNSTABLE):
            return run
        # a motor without a controller isn't in the loop
        columns = simulation.recording.columns
        velocities = [columns.get(f"{PLANT}.{name}") for name in VELOCITIES]
        held = [name in parts.constants for name in TORQUES]
        unstable = divergence(run, [None if no else each for each, no in zip(velocities, held, strict=True)])
        if unstable is None:
            return run
        if run.completed:
            return replace(
                run, health=replace(run.health, messages=(unstable, *run.health.messages), unstable_loop=unstable)
            )
        # if the loop has diverged before a slave fails, the loop is the cause
        return replace(run, outcome=Outcome.LOOP_UNSTABLE, message=f"{unstable}; in the end {run.message}")

    def check_size(self) -> None:
        """Refuse a run whose recording is too large with its companion's.

        Raises:
            InputError: they have more than 2 GB; see `flexfmu.cosim.experiment.run_size.check_size`.
        """
        steps = self._step, companion_step(self._parts, self._loop.motion, self._step)
        sizes = [recorded_bytes(self._parts, self._recording.needed, self._stop_time, each) for each in steps]
        check_size(self._loop.motion, self._parts, sizes, self._step)

    def _delays(self, found: Sequence[SignalDelay]) -> tuple[SignalDelay, ...]:
        """The delays of the loop: disturbances act when they say."""
        sources = tuple(f"{each.name}." for each in self._loop.disturbances)
        return tuple(each for each in found if not each.connection.startswith(sources))

    def replan(self, scene: Scene) -> bool:
        """Run the motion of another scene from now on; earlier runs keep theirs.

        Returns:
            False, and nothing is changed, if the scene differs in more than its ``[trajectory]``, or more than references
            and stop time depends on the motion: other slaves, or parameters of the FMU.

        Raises:
            TrajectoryError: the motion is not feasible.
            InputError: the communication step is longer than the motion.
        """
        # motion-driven, without further slaves, and from the same start, which is a parameter of the FMU
        before, watch = self._again["scene"], Stopwatch()
        alone = self._plans and not self._parts.others and scene.cosimulation.drive == "motion"
        same = scene == before.model_copy(update={"trajectory": scene.trajectory})
        if not (alone and same and scene.start == before.start):
            return False
        loop = loop_of(scene)
        check_step(self._step, loop.motion.once.duration)
        self._loop, self._stop_time = loop, loop.motion.stop_time
        self._again = {**self._again, "scene": scene, "loop": loop}
        self._parts.references.follow(loop.driving)
        self._recording.follow(RigidMotion(loop.motion))
        self._instants.follow(loop.motion)
        self._rests = self._rests.after(loop.motion)
        planning = watch.lap()
        # after an error the next run makes a new simulator
        simulator, self._simulator = self._simulator, None
        if simulator is not None:
            simulator.move_to(self._stop_time)
            self._simulator = simulator
        self._times = planning, 0.0, watch.lap()
        return True

    @property
    def stop_time(self) -> float:
        """End of the simulation [s]; by default the end of motion and dwell."""
        return self._stop_time

    @stop_time.setter
    def stop_time(self, value: float) -> None:
        self._stop_time, self._simulator = value, None
        self._instants.forget()

    def _simulated(self, points: RealArray | None, tolerance: float, *, progress: Progress | None = None) -> Simulation:
        """Simulate with these communication points, or with the communication step."""
        if self._simulator is None or points is not self._points:
            self._points, self._simulator = points, self._ready(points)
        return self._simulator.run(tolerance, progress)

    def _ready(self, points: RealArray | None = None) -> Simulator:
        """The simulator with the current stop time."""
        return Simulator(
            self._system,
            self._stop_time,
            self._step,
            algorithm=self._coupling.algorithm,
            step_control=self._coupling.step_control,
            record=self._recording.needed,
            isolation=self._isolation,
            points=points,
        )

    def _companion(self, parameters: Mapping[str, float]) -> Companion:
        """The companion: communication steps that divide those of the run, and tighter tolerances."""
        step = companion_step(self._parts, self._loop.motion, self._step)
        tolerance = max(COMPANION_TOLERANCE * self._tolerance, LEAST_TOLERANCE)
        finer = {**self._again, "communication_step": step, "tolerance": tolerance}
        share = companion_share(self._again["scene"], self._parts, self._tolerance, tolerance)
        return Companion(step, tolerance, partial(_run_companion, finer, self._stop_time, dict(parameters)), share)

    def isolate_python_slaves(self) -> None:
        """Isolate Python slaves passed as objects too, so that runs don't change them, unless isolation is switched off."""
        self._isolation = isolation(self._isolate, self._parts.slaves, self._call_limit, theirs=False)


def _with_keys(message: str) -> str:
    """A message of the FMU with the scene's keys for its parameters."""
    for parameter, key in KEYS.items():
        message = message.replace(parameter, key)
    return message


def _run_companion(
    arguments: Mapping[str, Any], stop_time: float, parameters: Mapping[str, float], progress: Progress | None = None
) -> Run:
    """Prepare and run a companion, also with a finer fixed integrator step or step control if the scene has them."""
    scene = arguments["scene"]
    section, changes = scene.cosimulation, dict[str, Any]()
    # finer settings of everything else that limits the accuracy
    if section.integrator_step > 0.0:
        changes["cosimulation.integrator_step"] = 0.5 * section.integrator_step
    if section.step_control is not None:
        changes["cosimulation.step_control.tolerance"] = COMPANION_COUPLING * section.step_control.tolerance
    prepared = PreparedScene(**{**arguments, "scene": scene.replace(changes) if changes else scene})
    prepared.isolate_python_slaves()
    prepared.stop_time = stop_time
    return prepared.run(parameters, progress)

"""Prepared scenes: planned motion → FMU → connected system → simulation → recording, once or many times, with metrics and companions.

A companion has a hundredth of the tolerance and at most half of the steps. Errors of integration shrink like the tolerance to
the power p/(p + 1) for a method of order p, those of input polynomials and interpolation like the step to the sixth power at
least, by 1/64: its error is a few hundredths of the change from the run to it. `ORDERLY` is six times that. Where a mode rings
undamped, where signals are rounded, or where slaves of unknown order are coupled, nothing shrinks by order, and a change may be
small by chance. The factors are those with which 99.5 % of all errors hold (`benchmarks/stated_errors.py`).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from math import ceil, inf
from typing import Any, Unpack

from flexfmu.cosim.engine.errors import InputError, LoopWarning, suggestion
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation
from flexfmu.cosim.engine.master.simulator import Progress, Simulator, isolation
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.slave import COINCIDENT, RealArray, Sampled
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.recorded_instants import RecordedInstants
from flexfmu.cosim.experiment.recording import VELOCITIES, RigidMotion, SceneRecording, slave_facts
from flexfmu.cosim.experiment.run_checks import check_size, check_step, divergence, recorded_bytes
from flexfmu.cosim.experiment.run_options import SceneOptions
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of
from flexfmu.cosim.experiment.scene_run import NO_ORDER, Companion, Health, RestPositions, Run, Timing
from flexfmu.cosim.experiment.system import PLANT, TORQUES, SceneSystem, coupling_of, scene_system
from flexfmu.cosim.experiment.timing import Stopwatch
from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE
from flexfmu.model.scene.effects import Effects
from flexfmu.model.scene.schema import Scene

ORDERLY, LOOSE, TIGHT = 0.1, 1.0, 1.0
"""The same by order; at loose tolerances, where it isn't reached yet; where steps and rounding limit a companion, or a fixed step is halved."""

LOOSEST, TIGHTEST = 1e-5, 1e-9
"""A run's tolerance above which it counts as loose, and a companion's below which it counts as tight."""

LEAST_ORDER = 5
"""Degree of the input polynomials from which on their error has an order of six or more."""

LEAST_RATIO, LEAST_TIME = 0.01, 1e-6
"""Modal damping ratio, and time constant of stiffness damping [s], below which modes of some kHz ring to the end of a motion."""


COMPANION_STEPS = 2000
"""Smallest number of communication steps of a companion over the motion; with fewer, both runs could miss the same
motion between communication points."""

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

TOO_LONG = "with the fixed step"
"""What the FMU's messages of a fixed step that is too long have in them."""


def run_scene(
    scene: Scene,
    *,
    motion: MotionPlan | None = None,
    loop: Loop | None = None,
    parameters: Mapping[str, float] | None = None,
    progress: Progress | None = None,
    accept_size: bool = False,
    **options: Unpack[SceneOptions],
) -> Run:
    """Plan the scene's motion, build its FMU or take it from the cache, and co-simulate motion and dwell.

    The system includes the scene's controllers, shapers and imperfections. A robot driven by torques without a controller
    gets constant torques that hold its start pose.

    Args:
        scene: the scene.
        motion: motion, planned from the same scene, instead of the scene's own motion with its shapers.
        loop: controllers, shapers and imperfections instead of the scene's sections.
        parameters: FMU parameters that differ from the scene's, for example ``{"payload.mass": 0.1}``.
        progress: called repeatedly with the simulated fraction, 0..1.
        accept_size: whether to run however large the recording is.
        options: communication step [s], tolerance, FMU, recorded signals and more: `flexfmu.cosim.experiment.run_options.SceneOptions`.

    Returns:
        The run; if a slave fails, with the recording up to then. A completed run whose control loop is unstable says so in
        ``health`` and by a `LoopWarning`.

    Raises:
        TrajectoryError: the motion is not feasible, or can't be shaped.
        InputError: an FMU can't be loaded or lacks a variable, a parameter doesn't exist or is out of range, the
            slaves can't be connected, or the recordings of the run and its companion have more than 2 GB.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    prepared = PreparedScene(scene, motion=motion, loop=loop, **options)
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
        motion: MotionPlan | None = None,
        loop: Loop | None = None,
        **options: Unpack[SceneOptions],
    ) -> None:
        if unknown := [*(options.keys() - SceneOptions.__optional_keys__)]:
            raise TypeError(
                f"a scene has no option {unknown[0]!r}; {suggestion(unknown[0], SceneOptions.__optional_keys__)}"
            )
        for name in ("communication_step", "tolerance", "call_limit"):
            value = options.get(name)
            if value is not None and (isinstance(value, str) or not 0.0 < value < inf):  # type: ignore[operator]
                raise InputError(f"{name} must be a finite number above 0, got {value!r}")
        if scene.is_open:
            what = "numerical settings" if scene.accuracy else "effects"
            raise InputError(
                f"scene {scene.name} leaves the choice of {what} open: run it with `flexfmu.run`, or choose first, with "
                f"`flexfmu.cosim.design.effects.choice.resolved(scene)`"
            )
        # plan the motion; make controllers, shapers and imperfections
        watch, section = Stopwatch(), scene.cosimulation
        self._loop = loop_of(scene, motion) if loop is None else loop
        self._plans = loop is None and motion is None
        planning = watch.lap()
        # build the FMU, or take it from the cache
        self._fmu_path = options.get("fmu_path") or build_scene(scene, shared=True).path
        building = watch.lap()
        # load the FMU and connect the system
        self._parts = scene_system(
            scene, self._loop, self._fmu_path, initial=options.get("initial"), input_order=options.get("input_order")
        )
        self._coupling = coupling_of(section)
        self._system = connect(self._parts.slaves, self._parts.wiring.connections, loops=self._coupling.loops)
        # what the options leave open is as the scene says; without a step from either, steps are chosen
        step, tolerance, isolate = options.get("communication_step"), options.get("tolerance"), options.get("isolate")
        fixed = section.step if step is None else step
        self._step = section.communication_step if fixed is None else fixed
        self._stop_time = self._end_of(self._loop.motion)
        check_step(self._step, self._loop.motion.once.duration)
        self._tolerance = section.tolerance if tolerance is None else tolerance
        self._isolate = section.isolate if isolate is None else isolate
        self._call_limit = options.get("call_limit") or section.call_limit
        record = options.get("record") or Selection(section.record, section.record_order, section.record_step)
        self._instants = RecordedInstants(self._parts, self._loop.motion, fixed, record)
        objects = loop is not None or scene.has_objects
        self._isolation = isolation(self._isolate, self._parts.slaves, self._call_limit, caller_owned=objects)
        self._recording = SceneRecording(self._parts, RigidMotion(self._loop.motion), self._instants.recorded)
        self._facts = slave_facts(self._parts.slaves)
        self._rests = RestPositions(self._loop.motion, self._fmu_path)
        # the simulator is made at the first run; a companion is prepared with the same options
        self._simulator: Simulator | None = None
        self._points: RealArray | None = None
        self._scene, self._options = scene, options
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
        message = "; ".join((*hints, simulation.message))
        for parameter, key in KEYS.items():
            message = message.replace(parameter, key)
        # disturbances have instants of their own: their signals aren't late
        disturbing = tuple(f"{each.name}." for each in self._loop.disturbances)
        run = Run(
            plan=self._loop.motion,
            recording=self._recording.of(simulation.recording, parts),
            outcome=simulation.outcome,
            message=message,
            fmu_path=self._fmu_path,
            communication_step=self._step,
            tolerance=self._tolerance,
            input_order=parts.references.announced_order,
            health=Health(parts.plant.statistics, parts.plant.messages),
            timing=timing,
            slaves=self._facts,
            delays=tuple(each for each in simulation.delays if not each.connection.startswith(disturbing)),
            parameters=parts.changes,
            companion=self._companion(parts.changes),
            rests=self._rests,
            measure=_measured,
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
        if TOO_LONG in run.message:
            # an integrator whose fixed step is too long diverges by itself
            return replace(run, message=f"{run.message}; if that changes nothing, {unstable}")
        run = replace(
            run, health=replace(run.health, messages=(unstable, *run.health.messages), unstable_loop=unstable)
        )
        if run.completed:
            return run
        # if the loop has diverged before a slave fails, the loop is the cause
        return replace(run, outcome=Outcome.LOOP_UNSTABLE, message=f"{unstable}; in the end {run.message}")

    def check_size(self, *, companion: bool = True) -> None:
        """Refuse a run whose recording is too large, by default with its companion's.

        Raises:
            InputError: they have more than 2 GB; see `flexfmu.cosim.experiment.run_checks.check_size`.
        """
        steps = [self._step]
        steps += [companion_step(self._parts, self._loop.motion, self._step)] if companion else []
        sizes = [recorded_bytes(self._parts, self._recording.needed, self._stop_time, each) for each in steps]
        check_size(self._loop.motion, self._parts, sizes, self._step)

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
        before, watch = self._scene, Stopwatch()
        alone = self._plans and not self._parts.others and scene.cosimulation.drive == "motion"
        same = scene == before.model_copy(update={"trajectory": scene.trajectory})
        if not (alone and same and scene.start == before.start):
            return False
        loop = loop_of(scene)
        check_step(self._step, loop.motion.once.duration)
        self._scene, self._loop, self._stop_time = scene, loop, self._end_of(loop.motion)
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

    def _end_of(self, motion: MotionPlan) -> float:
        """The end of motion and dwell [s]; a dwell in which the master has no instant of its own is none."""
        return motion.stop_time if motion.stop_time - motion.duration > COINCIDENT * self._step else motion.duration

    @property
    def parts(self) -> SceneSystem:
        """The slaves and their connections."""
        return self._parts

    @property
    def recording(self) -> SceneRecording:
        """What makes the scene's recording of the master's."""
        return self._recording

    @property
    def simulator(self) -> Simulator:
        """What simulates; there must have been a run."""
        assert self._simulator is not None
        return self._simulator

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
            self._points = points
            self._simulator = Simulator(
                self._system,
                self._stop_time,
                self._step,
                algorithm=self._coupling.algorithm,
                step_control=self._coupling.step_control,
                record=self._recording.needed,
                isolation=self._isolation,
                points=points,
            )
        return self._simulator.run(tolerance, progress)

    def _companion(self, parameters: Mapping[str, float]) -> Companion:
        """The companion: communication steps that divide those of the run, and tighter tolerances."""
        step = companion_step(self._parts, self._loop.motion, self._step)
        tolerance = max(COMPANION_TOLERANCE * self._tolerance, LEAST_TOLERANCE)
        finer = self._options | SceneOptions(communication_step=step, tolerance=tolerance, fmu_path=self._fmu_path)
        share = companion_share(self._scene, self._parts, self._tolerance, tolerance)
        return Companion(
            step,
            tolerance,
            partial(_run_companion, self._scene, self._loop, finer, self._stop_time, dict(parameters)),
            share,
        )

    def isolate_python_slaves(self) -> None:
        """Isolate Python slaves passed as objects too, so that runs don't change them, unless isolation is switched off."""
        self._isolation = isolation(self._isolate, self._parts.slaves, self._call_limit, caller_owned=False)


def _measured(run: Run, companions: int, names: Collection[str] | None) -> Mapping[str, Metric]:
    """The metrics of a run."""
    from flexfmu.cosim.metrics.metrics import measure_run  # which runs whose metrics aren't asked for do without

    return measure_run(run, companions, names)


def _run_companion(
    scene: Scene,
    loop: Loop,
    options: SceneOptions,
    stop_time: float,
    parameters: Mapping[str, float],
    progress: Progress | None = None,
) -> Run:
    """Prepare and run a companion, also with a finer fixed integrator step or step control if the scene has them."""
    section, changes = scene.cosimulation, dict[str, Any]()
    # finer settings of everything else that limits the accuracy
    if section.integrator_step > 0.0:
        changes["cosimulation.integrator_step"] = 0.5 * section.integrator_step
    if section.step_control is not None:
        changes["cosimulation.step_control.tolerance"] = COMPANION_COUPLING * section.step_control.tolerance
    prepared = PreparedScene(scene.replace(changes) if changes else scene, loop=loop, **options)
    prepared.isolate_python_slaves()
    prepared.stop_time = stop_time
    return prepared.run(parameters, progress)


def companion_step(parts: SceneSystem, motion: MotionPlan, step: float) -> float:
    """Return the communication step of a companion [s], which divides that of the run and is at most half of every sample time."""
    samples = (0.5 * each.sample_time for each in parts.slaves if isinstance(each, Sampled))
    longest = min(0.5 * step, motion.once.duration / COMPANION_STEPS, *samples)
    return step / ceil(step / longest * (1.0 - 1e-9))


def companion_share(scene: Scene, parts: SceneSystem, tolerance: float, companions_tolerance: float) -> float:
    """Return the largest error of a companion, in terms of the change of a metric from the run to it.

    Args:
        scene: the scene.
        parts: its slaves.
        tolerance, companions_tolerance: relative tolerances of both.
    """
    section = scene.cosimulation
    known = (
        not _is_hardly_damped(scene.effects)
        and section.step_control is None
        and section.algorithm == "gauss-seidel"
        and parts.references.announced_order >= LEAST_ORDER
        and all(getattr(each, "is_continuous", False) for each in parts.others)
        and companions_tolerance < 0.5 * tolerance
    )
    if not known:
        return NO_ORDER
    if companions_tolerance < TIGHTEST or section.integrator_step > 0.0:
        return TIGHT
    return LOOSE if tolerance > LOOSEST else ORDERLY


def _is_hardly_damped(effects: Effects) -> bool:
    """Whether fast modes are undamped, or hardly damped."""
    families = ("proximal_bending", "proximal_axial", "distal_bending", "distal_axial")
    drives = effects.transmission is not None and effects.transmission.damping == 0.0
    if not any(getattr(effects, family) and family not in effects.quasi_static for family in families):
        return drives
    ratio, time = getattr(effects.damping, "ratio", 0.0), getattr(effects.damping, "time", 0.0)
    return drives or (ratio < LEAST_RATIO and time < LEAST_TIME)

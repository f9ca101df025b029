"""The functions of `import flexfmu`; each docstring names the function with more options that it calls."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, Unpack

from flexfmu.cosim.engine.errors import InputError, LoopWarning, RunWarning, suggestion
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulator import Progress
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.planning import plan as plan_of
from flexfmu.cosim.experiment.run_options import RunOptions
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.naming import Naming
from flexfmu.fmu_build.toolchain import FmiVersion
from flexfmu.model.scene.file import as_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.systems import Part, Parts, listed, wires, with_parts

if TYPE_CHECKING:
    import control

    from flexfmu.cosim.design.gains.tuner import TuneResult
    from flexfmu.cosim.design.identification.experiments import ProposedMotions
    from flexfmu.cosim.design.identification.result import Identification
    from flexfmu.cosim.design.margins.scene_margins import MarginsResult
    from flexfmu.cosim.design.plans.plan_result import PlanResult
    from flexfmu.cosim.design.response.response import FrequencyResponse
    from flexfmu.cosim.engine.measured import Log
    from flexfmu.cosim.experiment.accuracy import AccuracyAnswer
    from flexfmu.cosim.reports.modes_table import ModesAlongPath
    from flexfmu.cosim.studies.compare.comparison import Comparison
    from flexfmu.cosim.studies.sweep.result import SweepResult
    from flexfmu.trajectories.sources import OwnMotion
    from flexfmu.trajectories.trajectory import Trajectory


SceneSource = Scene | Path | str
"""A scene, the path of a scene file, or the name of a shipped scene."""


def resolved(scene: Scene) -> Scene:
    """Return the scene with what it leaves open chosen."""
    return resolved_with_answer(scene)[0]


def resolved_with_answer(scene: Scene) -> tuple[Scene, AccuracyAnswer | None]:
    """Return the scene with what it leaves open chosen, and the answer to ``[accuracy]``; CasADi is loaded only for that."""
    if not scene.is_open and not scene.learners:
        return scene, None
    from flexfmu.cosim.design.effects import choice

    return choice.resolved_with_answer(scene)


def run(
    scene: SceneSource,
    *,
    fmu: str | Path | None = None,
    trajectory: OwnMotion | Trajectory | None = None,
    controllers: Iterable[Part] | None = None,
    shapers: Iterable[Part] | None = None,
    imperfections: Iterable[Part] | None = None,
    filters: Iterable[Part] | None = None,
    disturbances: Iterable[Part] | None = None,
    connect: Mapping[str, str] | None = None,
    accuracy: Mapping[str, float | str] | None = None,
    **options: Unpack[RunOptions],
) -> Run:
    """Co-simulate a scene over its motion and the dwell that follows.

    Plans the motion, builds the robot's FMU or takes it from the cache, and connects it with the scene's controllers, shapers
    and imperfections, or with those given. With ``effects = { select = "auto" }`` the effects are chosen first.

        run = flexfmu.run("barnard2012-6kg", parameters={"payload.mass": 3.0})
        run.recording.time, run.recording["joint1.torque"].values  # (N,) [s], (N,) [N.m]
        robot = flexfmu.load_scene("barnard2012-6kg").replace({"effects.motor_inertia": 0.1})
        pd = flexfmu.control.pd(proportional=1e4, derivative=100.0, sample_time=1e-3)
        flexfmu.run(robot, controllers=[pd], imperfections=[flexfmu.imperfections.encoder(counts_per_turn=2**17)])

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene.
        fmu: path of an existing FMU to simulate instead of building one. It must have the same effects as the scene; its
            parameters are set from the scene.
        trajectory: own motion instead of the scene's path and profile: an object with ``duration`` [s] and ``position(time)``,
            x and y [m], see `flexfmu.trajectories.sources`. The scene's shapers, controllers, cycles and dwell apply to it.
        controllers, shapers, imperfections, filters, disturbances: lists that replace the scene's: what the functions of
            `flexfmu.control`, `flexfmu.shapers` ... return, or tables (dicts) as in a scene file. The first three also take functions
            with `flexfmu.controller`, objects of a class of yours, python-control systems and paths of FMUs. Torques drive the
            robot where controllers or disturbances are given.
        connect: ``slave.input`` → ``slave.output``, where names differ; the robot is ``plant``, its references are those of
            ``trajectory``: ``{"plant.joint1.torque": "motor.y"}``.
        accuracy: metric → largest error, of model and numerics together: relative, a number, or absolute, a text with its unit,
            ``{"peak_torque_1": 1e-3, "end_position_error": "1 um"}``; replaces the scene's ``accuracy``. Effects, communication step,
            integrator and tolerance are chosen for it, and ``run.accuracy`` tells which, why, and what they cost.
        options: ``communication_step`` [s] and relative ``tolerance`` of the FMU's integrator, by default the scene's
            ``cosimulation.step`` and ``tolerance``; ``parameters``, values of FMU parameters that replace the scene's, by name, in SI
            units: ``{"payload.mass": 0.1}``; ``progress``, a function that is called during the run with the simulated fraction, 0
            to 1; ``accept_size``, whether to run however large the results are: otherwise more than 2 GB, a companion run for the
            errors included, are refused. All of them: `flexfmu.cosim.experiment.run_options.RunOptions`.

    Returns:
        The run. ``run.recording`` has the signals with their units, ``run.outcome`` and ``run.message`` tell how it ended,
        ``run.completed`` whether it reached the stop time. If a slave fails during the run, nothing is raised: the recording
        ends there, the outcome gives the reason, and a `RunWarning` says so; Ctrl-C ends a script, and in an interactive session
        gives the run until then. A control loop that is unstable, or nearly, is named in
        ``run.health.messages`` and by a `LoopWarning`; the messages also name encoders that are too coarse for the gains.
        ``run.metrics.peak_torque_1`` is a metric, ``run.to_pandas()`` a data frame, ``run.live()`` a page that simulates.

    Raises:
        SceneError: the scene doesn't exist, or one of its keys or values is invalid.
        TrajectoryError: the motion is not feasible, or can't be shaped.
        InputError: the FMU can't be loaded or lacks a variable, a parameter doesn't exist or is out of range, or the slaves
            can't be connected.
        BuildError: the FMU can't be built, for example without a compiler.
        ResultsError: with ``select = "auto"``, a run that verifies the choice of effects failed; with ``accuracy``, no settings
            have it.
        TypeError: ``scene`` is of another type.
    """
    parts = Parts(
        controllers=controllers,
        shapers=shapers,
        imperfections=imperfections,
        filters=filters,
        disturbances=disturbances,
        connect=connect,
    )
    if unknown := options.keys() - RunOptions.__optional_keys__:
        known = sorted(RunOptions.__optional_keys__ | parts.keys() | {"accuracy"})
        raise TypeError(f"run has no argument {min(unknown)!r}; {suggestion(min(unknown), known)}")
    if (record := options.get("record")) is not None and not isinstance(record, Selection):
        options["record"] = Selection(listed(record, "record"))
    if not isinstance(parameters := options.get("parameters") or {}, Mapping):
        raise InputError(f"parameters are values by name, got {parameters!r}: write {{'payload.mass': 0.1}}")
    if (progress := options.get("progress")) is not None and not callable(progress):
        raise InputError(f"progress is a function of the simulated fraction, got {progress!r}")
    robot = with_parts(as_scene(scene), parts)
    if accuracy is not None:
        robot = robot.replace({"accuracy": accuracy})
    if robot.accuracy and (trajectory is not None or fmu is not None or options.get("parameters")):
        raise InputError(
            "settings are chosen for the scene's own motion, FMU and parameters: change the scene, or leave out `accuracy`"
        )
    loop = None
    if trajectory is not None:
        from flexfmu.cosim.experiment.scene_loop import own_loop  # which few runs need

        loop = own_loop(robot, trajectory)
    if fmu is not None:
        options["fmu_path"] = Path(fmu)
    ready, answer = resolved_with_answer(robot) if loop is None else (loop.motion.scene, None)
    found = run_scene(ready, loop=loop, **options)
    found = replace(found, accuracy=answer, page=_live_page)
    if found.outcome is Outcome.INTERRUPTED and not hasattr(sys, "ps1"):
        raise KeyboardInterrupt(found.message)
    if found.outcome.is_failure and found.outcome is not Outcome.LOOP_UNSTABLE:  # of which `run_scene` has warned
        warnings.warn(f"{found.outcome.value}: {found.message}", RunWarning, stacklevel=2)
    if not found.scene.controller:
        return found
    from flexfmu.cosim.design.margins.loop_warnings import loop_sentences  # which few runs need

    told = loop_sentences(found)
    if (unstable := told["stability"]) is not None:
        warnings.warn(unstable, LoopWarning, stacklevel=2)
    sentences = filter(None, (told["stability"], told["coarse_counts"]))
    return replace(found, health=replace(found.health, messages=(*found.health.messages, *sentences)))


def _live_page(run: Run) -> str:
    from flexfmu.cosim.exchange.live import live_page  # which few runs need

    return live_page(run)


def compare(
    *runs: Run | SceneSource,
    measured: Log | None = None,
    mapping: Mapping[str, str] | None = None,
    delay: float | None = None,
    payload_band: float | tuple[float, float] | None = None,
    strict: bool = False,
    **parts: Unpack[Parts],
) -> Comparison:
    """Compare runs, controllers and shapers with each other, and with a measurement.

        comparison = flexfmu.compare(run, "scene.toml", measured="log.csv", mapping={"tau1": "joint1.torque*1e-3"})
        comparison.to_pandas()  # metrics side by side
        comparison.write("comparison")  # comparison.html and comparison.json
        flexfmu.compare(scene, scene.replace({"name": "stiff", "pd.kp": 2e4}), payload_band=0.2)  # two controllers

    Calls `flexfmu.cosim.studies.compare.comparison.compare_runs`.

    Args:
        runs: runs, folders or files of results (.csv, .parquet, .mat), or scenes, which are run now. Differences are relative to
            the first one. A scene whose loop is unstable has a ``failure`` instead of metrics.
        measured: a measurement: a CSV file with a header, a data frame, or a `Recording`.
        mapping: column of the measurement → ``signal*factor+offset``; factor (a number, or a unit such as ``deg``) and offset may be left
            out, and ``time`` is the time. Other columns are taken where their name is that of a signal.
        delay: time of an event in the measurement minus that in the simulation [s]; None to estimate it from the first run.
        payload_band: scenes are also run with other payloads, which their controllers, shapers and motion don't know: a fraction to
            both sides, or the lightest and the heaviest payload [kg]; None to skip them.
        strict: whether a value in a file that is no finite number is an error; otherwise such values are left out, with a warning that
            names the first one's line.
        parts: ``controllers``, ``shapers``, ``imperfections``, ``filters``, ``disturbances`` and ``connect`` as for `run`.

    Returns:
        The runs with metrics and signals; ``comparison.runs[0].loop`` has margins and processor time [s] of a scene,
        ``comparison.runs[0].band.worst`` its metrics with the worse payload; ``comparison.measured.delay`` with its standard error, and
        ``comparison.measured.differences[run][signal].root_mean_square`` over the time that measurement and run have in common.

    Raises:
        SceneError: a scene doesn't exist, or one of its keys or values is invalid.
        TrajectoryError, BuildError: a scene can't be run.
        InputError: a folder has no results, a column or signal doesn't exist, or the delay can't be estimated.
        ResultsError: a file can't be read, or a run failed.
    """
    from flexfmu.cosim.engine.measured import as_mapped
    from flexfmu.cosim.studies.compare.comparison import compare_runs
    from flexfmu.cosim.studies.compare.sources import compared_runs

    if parts:
        runs = tuple(
            with_parts(as_scene(each), parts) if isinstance(each, Scene | str | Path) else each for each in runs
        )
    meaning = {column: as_mapped(text) for column, text in (mapping or {}).items()}
    compared = compared_runs(runs, payload_band=payload_band, strict=strict)
    return compare_runs(compared, measured, meaning, delay, strict=strict)


def identify(
    model: SceneSource,
    logs: Log | Sequence[Log | tuple[Log, Mapping[str, Any]]],
    free: Iterable[str] | Mapping[str, float | tuple[float, float]],
    *,
    mapping: Mapping[str, str] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    sensors: Collection[str] | None = None,
    loss: Literal["linear", "robust"] = "linear",
    starts: int = 1,
    seed: int = 0,
    segments: Sequence[tuple[float, float]] = (),
    explain: bool | None = None,
    step: float | None = None,
    tolerance: float | None = None,
    strict: bool = False,
    out: str | Path | None = None,
    progress: Callable[[str, float | None], None] | None = None,
) -> Identification:
    """Estimate parameters of a scene's robot, or of anybody's FMU, from measurements.

        found = flexfmu.identify("robot.toml", "log.csv", ["payload.mass", "damping.ratio"], mapping={"M1": "joint1.torque*1e-3"})
        found.values["payload.mass"], found.estimates[0].interval, found.scene
        flexfmu.identify("VanDerPol.fmu", "log.csv", {"mu": (0.1, 10.0)})

    Calls `flexfmu.cosim.design.identification.study.identify_scene` or `identify_fmu`.

    Args:
        model: a scene, the path of a scene file, or the name of a shipped scene; or the path of an FMU (``.fmu``).
        logs: CSV files with a header, data frames or `Recording`; one, several, or pairs of a log and keys of the scene for it alone:
            ``("heavy.csv", {"payload.mass": 6.0})``. Columns of both joints' references or angles drive a motion-driven robot, torques
            of both motors a torque-driven one without controllers; otherwise it makes the scene's own motion. Columns that are named
            like an FMU's inputs drive it. A frequency response, or a table of modes (files, `FrequencyResponse` or its ``modes()``), belongs to
            small motions about the end of the path, or about ``{"pose": (x, y)}`` [m]; see docs/identify.md.
        free: keys of the scene, or names of an FMU's parameters and start values: ``["payload.mass", "motor_inertia=0.01"]``, or a
            dict of first values or of bounds.
        mapping: column → ``signal*factor+offset``, as for `compare`; also ``link11.strain[0.25]``, the strain of an outer fibre, and
            ``joint1.current`` with the scene's ``motor.torque_constant``.
        priors: key → mean and standard deviation of what is known beforehand.
        sensors: what is unknown of them: a ``"delay"`` of each kind of signal, an ``"offset"`` of each signal, a ``"gain"``. None for
            delay and offset with a scene, nothing with an FMU.
        loss: ``"robust"`` against outliers.
        starts: number of first values from which the least squares are looked for.
        seed: of these.
        segments: intervals of the logs' times whose samples count [s].
        explain: whether effects that the scene lacks are tried; None for where the residuals depend on the motion, or several
            parameters are free.
        step, tolerance: communication step [s] and relative tolerance of an FMU; None for its own.
        strict: whether a value in a log that is no finite number is an error; otherwise it is left out, with a warning.
        out: folder for ``identified.html``, ``identified.json``, and ``draws.csv``, cases for `sweep`; None for memory alone.
        progress: function that is called with what is being done, and the finished fraction.

    Returns:
        Values with standard errors, intervals of 95 % confidence and correlations, tests of the residuals, and the scene with the values.

    Raises:
        InputError: a key or a log can't be used, or the log isn't one of this robot.
        SceneError: the scene doesn't exist, or a value is out of range.
        BuildError: the FMU can't be built.
        ResultsError: a simulation failed, or a file can't be written.
    """
    from flexfmu.cosim.design.identification.study import Estimation, LogSource, identify_fmu, identify_scene
    from flexfmu.cosim.engine.measured import as_mapped
    from flexfmu.cosim.engine.showing import quiet

    several = logs if isinstance(logs, Sequence) and not isinstance(logs, str) else [logs]
    sources = [LogSource(*each) if isinstance(each, tuple) else LogSource(each, {}) for each in several]
    fmu = Path(model) if isinstance(model, str | Path) and Path(model).suffix == ".fmu" else None
    wanted = Estimation(
        free,
        (("delay", "offset") if fmu is None else ()) if sensors is None else sensors,
        {column: as_mapped(text) for column, text in (mapping or {}).items()},
        priors or {},
        loss,
        starts,
        seed,
        segments,
        strict,
        progress or quiet,
    )
    if fmu is not None:
        found = identify_fmu(fmu, sources, wanted, step, tolerance)
    elif step is not None or tolerance is not None:
        raise InputError(
            "step and tolerance are those of an FMU: a scene has its own, cosimulation.step and cosimulation.tolerance"
        )
    else:
        found = identify_scene(resolved(as_scene(model)), sources, wanted, explain)
    if out is not None:
        found.write(out)
    return found


def propose_motions(
    scene: SceneSource,
    free: Iterable[str] | Mapping[str, float | tuple[float, float]],
    *,
    signals: Sequence[str] = ("joint1.torque", "joint2.torque"),
    noise: float = 0.01,
    sample_time: float = 1e-3,
    sensors: Collection[str] = ("delay", "offset"),
    criterion: Literal["D", "A"] = "D",
    progress: Callable[[str, float | None], None] | None = None,
) -> ProposedMotions:
    """Which motions of a scene's families would determine parameters best, within its limits.

        found = flexfmu.propose_motions("robot.toml", ["payload.mass", "damping.ratio"])
        found.best.errors["payload.mass"], scene.replace(found.best.changes)

    Calls `flexfmu.cosim.design.identification.experiments.propose_motions`.

    Args:
        scene: a scene with path and profile that motion drives, its path, or the name of a shipped scene.
        free, sensors: as for `identify`.
        signals: what will be measured.
        noise: standard deviation of white noise, relative to each signal's largest value in the scene's own motion.
        sample_time: of the log [s].
        criterion: determinant (``"D"``) or trace (``"A"``) of the parameters' relative covariance.
        progress: function that is called with what is being done, and the finished fraction.

    Returns:
        All motions, those within the limits first, with the standard errors to be expected.

    Raises:
        InputError: a key or signal doesn't exist, or the scene has no path and profile.
        SceneError: the scene doesn't exist, or a value is out of range.
        BuildError: the FMU can't be built.
    """
    from flexfmu.cosim.design.identification import experiments
    from flexfmu.cosim.design.identification.study import free_parameters

    base, parameters = free_parameters(resolved(as_scene(scene)), free, {})
    return experiments.propose_motions(
        base,
        parameters,
        signals=signals,
        noise=noise,
        sample_time=sample_time,
        sensors=sensors,
        criterion=criterion,
        show=progress or (lambda text, fraction: None),
    )


def build(
    scene: SceneSource | SymbolicModel,
    output: str | Path | None = None,
    *,
    platforms: Iterable[str] | None = None,
    naming: Naming = "structured",
    enumerations: bool = False,
    fmi: FmiVersion | Literal[2, 3] = "2",
    step: float | None = None,
    stop_time: float | None = None,
    tolerance: float | None = None,
) -> Path:
    """Build the FMU of a scene's robot or of a model from equations, for co-simulation and model exchange, or take it from the cache.

    `flexfmu.cosim.experiment.scene_build.build_scene` and `flexfmu.fmu_build.build.build_fmu` do the same and also return GUID, size and
    build time.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene; or what `flexfmu.ode`, `second_order`, `lagrangian` or
            `dae` returns.
        output: file to write; None leaves the FMU in the cache.
        platforms: FMI platforms whose binaries the FMU gets: linux64, win64, darwin64, aarch64-linux, aarch64-darwin; None
            for this machine's. ``wasm32``, by itself, gives a WebAssembly module: ``output`` is its folder.
        naming: names of the FMU's variables, ``structured`` (``link11.bending[1]``) or ``flat`` (``link11_bending_1``).
        enumerations: whether the parameters ``initial`` and ``integrator`` are FMI Enumerations instead of Integers.
        fmi: version of FMI, 2 for 2.0 or 3 for 3.0, as number or text.
        step, stop_time, tolerance: communication step [s], end [s] and relative tolerance of a model's default experiment; None for
            0.2 ms, 1 s and 1e-6. A scene has its own.

    Returns:
        The path of the FMU.

    Raises:
        InputError: step, stop time or tolerance are given for a scene.
        SceneError: the scene doesn't exist, or one of its keys or values is invalid.
        BuildError: a platform or version is unknown, there is no compiler, the compiler fails, or the file can't be written.
        TrajectoryError, ResultsError: with ``select = "auto"``, the motion is not feasible, or a run that verifies the choice
            of effects failed.
        TypeError: ``scene`` is of another type.
    """
    target = None if output is None else Path(output)
    usual = {"step": step, "stop_time": stop_time, "tolerance": tolerance}
    experiment: dict[str, Any] = {name: value for name, value in usual.items() if value is not None}
    if isinstance(scene, SymbolicModel):
        return build_fmu(
            scene, target, platforms=platforms, naming=naming, enumerations=enumerations, fmi=fmi, **experiment
        ).path
    if experiment:
        raise InputError(f"{min(experiment)} is for models from equations; a scene has its own, under [cosimulation]")
    chosen = resolved(as_scene(scene))
    return build_scene(
        chosen, output=target, platforms=platforms, naming=naming, enumerations=enumerations, fmi=fmi
    ).path


def reference_motion(scene: SceneSource, trajectory: OwnMotion | Trajectory | None = None) -> MotionPlan:
    """The motion of a scene as references of the joints, with its way back and cycles but without its shapers, checked along the path.

    `plan_motion` looks for a better one.

    Calls `flexfmu.cosim.experiment.planning.plan`; ``plan.once`` is the plan of a single motion.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene.
        trajectory: own motion instead of the scene's path and profile, as for `run`.

    Returns:
        The plan: ``plan.task`` is the trajectory of the rigid end effector, x and y [m], ``plan.joints`` that of the motors,
        q11 and q21 [rad]. ``plan.joints.evaluate(time, order=2)`` returns values, rates and accelerations at ``time`` (N,) [s]
        as an array of shape (3, N, 2); any order is possible.

    Raises:
        SceneError: the scene doesn't exist, or one of its keys or values is invalid.
        TrajectoryError: the path is not feasible, leaves the workspace or comes too close to a singularity, or the own motion
            can't be used.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.cosim.experiment.cycles import in_cycles  # which few scenes need

    robot = as_scene(scene)
    if trajectory is None:
        return in_cycles(plan_of(robot))
    from flexfmu.cosim.experiment.planning import plan_own

    return in_cycles(plan_own(robot, trajectory))


def plan_motion(
    scene: SceneSource,
    *,
    methods: Collection[str] | None = None,
    candidates: Mapping[str, OwnMotion | Trajectory] | None = None,
    warm_start: str | Path | None = None,
    processes: int | None = None,
    budget: float | None = None,
    robust: bool = True,
    out: str | Path | None = None,
    restart: bool = False,
    progress: Callable[[str, float | None], None] | None = None,
    **wishes: Any,
) -> PlanResult:
    """Plan the best motion within limits that hold over a band of payloads: the fastest one by default.

        result = flexfmu.plan_motion("barnard2012-6kg", payload_band=0.2, limits={"torque": 80.0}, out="planned")
        result.chosen.time, result.to_pandas()

    Calls `flexfmu.cosim.design.plans.planner.plan_scene`.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene.
        methods: which of ``search``, ``flexible`` and ``optimal``; None for ``optimal``, and for all beside a front or where it finds no
            motion within all limits.
        candidates: name → further motion to compare with those found, as `run` takes it.
        warm_start: folder of an earlier plan, whose motion optimal control goes on from; None for a plan from the beginning.
        processes: number of processes of the search; None for one on each processor.
        budget: time [s] after which no further candidate is started; None for no limit.
        robust: whether the chosen motion is also run in richer models, up to half a minute.
        out: folder for ``planned.toml``, which every command takes, ``front.csv``, ``plan.json`` and ``plan.html``; all that is
            found is kept there at once, and the same call continues an interrupted one. None for no files.
        restart: whether what an interrupted plan for another scene or other limits has left in ``out`` is discarded.
        progress: function that is called with what is being done, and the finished fraction where it is known.
        wishes: keys of the scene file's section ``plan``, such as ``minimise``, ``residual`` [m] or ``limits``; they replace the
            scene's.

    Returns:
        The chosen and the given motion with their figures, and the Pareto front of all candidates. After Ctrl-C the best so far.

    Raises:
        SceneError: the scene doesn't exist, or a key, a wish or its value is invalid.
        TrajectoryError: the given motion is not feasible.
        InputError: wishes contradict each other, a method is unknown, or ``out`` has another plan.
        BuildError: the FMU can't be built.
        ResultsError: the given motion can't be run, or a file can't be written.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.cosim.design.plans.assessment import own_candidate
    from flexfmu.cosim.design.plans.plan_result import planned_scenes, write_plan
    from flexfmu.cosim.design.plans.planner import about_plan, plan_scene
    from flexfmu.cosim.many.journal import WorkJournal

    robot = as_scene(scene)
    if wishes:
        robot = robot.replace({f"plan.{key}": value for key, value in wishes.items()})
    before = [] if warm_start is None else planned_scenes(Path(warm_start))
    journal = WorkJournal(None if out is None else Path(out), "plan", about_plan(robot, before), restart=restart)
    result = plan_scene(
        robot,
        methods=methods,
        before=before,
        candidates=[own_candidate(robot, name, motion) for name, motion in (candidates or {}).items()],
        processes=processes or os.cpu_count() or 1,
        budget=budget,
        robust=robust,
        show=progress or (lambda text, fraction: None),
        journal=journal,
    )
    if out is not None:
        write_plan(result, Path(out))
    if not result.interrupted:
        journal.remove()
    return result


def modes(scene: SceneSource, poses: int = 11) -> ModesAlongPath:
    """Natural frequencies of the robot at poses along its path: undamped, motors locked, about the static equilibrium.

    Calls `flexfmu.cosim.reports.modes_table.modes_along_path`.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene.
        poses: number of poses, equally spaced by arc length from start to end; odd, so that the middle is one, and at least 3.

    Returns:
        The poses, each with the fraction ``s`` of the path's length (0 to 1), the position ``x``, ``y`` of the rigid end
        effector [m], the motor angles ``q11``, ``q21`` [rad], and ``frequencies`` [Hz] in ascending order, empty for a rigid
        robot.

    Raises:
        SceneError: the scene doesn't exist, or one of its keys or values is invalid.
        TrajectoryError: the path is not feasible, leaves the workspace or comes too close to a singularity.
        InputError: ``poses`` is even or below 3.
        EquilibriumError: the robot has no stable static equilibrium at a pose.
        BuildError, ResultsError: with ``select = "auto"``, the FMU of a run that verifies the choice of effects can't be built,
            or the run failed.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.cosim.reports.modes_table import modes_along_path

    return modes_along_path(plan_of(resolved(as_scene(scene))), poses)


def linearize(
    scene: SceneSource | SymbolicModel,
    position: tuple[float, float] | Mapping[str, float] = MappingProxyType({}),
    outputs: Sequence[str] | None = None,
) -> control.StateSpace:
    """Linearise the torque-driven robot about its static equilibrium at a pose, or a model about a point, for python-control.

    Calls `flexfmu.model.linear.linearize`, and for a model `flexfmu.fmu_build.own_models.linear_about`.

        flexfmu.linearize(cart_pole, {"theta": 0.0}, ["theta"])

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene; torques drive the robot whatever its
            ``cosimulation.drive``. Or a model from equations.
        position: x, y of the rigid end effector at the pose [m]. For a model the values of states and inputs at the point; the start
            value for others.
        outputs: names of FMU variables, for example ``["joint1.position"]``; None for all outputs of the FMU.

    Returns:
        The state space dx/dt = A x + B u, y = C x + D u in deviations from the equilibrium. The states are the coordinates
        [q_a, q_e] (motor angles, elastic coordinates) and their rates, the inputs ``joint1_torque``, ``joint2_torque`` [N.m],
        ``force_x`` and ``force_y`` [N]. Signals have the names and units of the FMU's variables, with underscores for dots.
        A model's states are coordinates, rates, and states of first order.

    Raises:
        SceneError: the scene doesn't exist, or one of its keys or values is invalid.
        InputError: the position isn't that of a scene.
        ModelError: a state, input or output of a model is unknown, or the model gives no finite number at the point.
        ValueError: an output is unknown, or the position is out of reach.
        EquilibriumError: the robot has no static equilibrium at the pose.
        TrajectoryError, BuildError, ResultsError: with ``select = "auto"``, the motion is not feasible, or a run that verifies
            the choice of effects can't be built or failed.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.fmu_build.own_models import linear_about  # needs CasADi, which `run` does without
    from flexfmu.model.linear import linearize as linearize_scene
    from flexfmu.model.linear import state_space

    if isinstance(scene, SymbolicModel):
        if not isinstance(position, Mapping):
            raise InputError(
                f"the point of a model gives values by name, {{'theta': 0.0}} for example, got {position!r}"
            )
        return state_space(scene, linear_about(scene, position, outputs))
    if isinstance(position, Mapping):
        raise InputError("linearize needs the position x, y [m] of the end effector of a scene")
    return linearize_scene(resolved(as_scene(scene)), position, outputs)


def margins(
    scene: SceneSource | SymbolicModel | Sequence[Any],
    connections: Mapping[str, str] | None = None,
    *,
    point: Mapping[str, float] | None = None,
    poses: int = 5,
    payload_band: float | tuple[float, float] | None = None,
    identified: Identification | str | Path | None = None,
    response: FrequencyResponse | str | Path | None = None,
    **parts: Unpack[Parts],
) -> MarginsResult:
    """Gain, phase, delay and disk margins of the sampled loop of a torque-driven scene, about equilibria along its path, or of a loop
    around a model from equations.

        result = flexfmu.margins("examples/controller_scene.toml")
        result.worst.gain_margin, result.to_pandas()
        flexfmu.margins([axis, pd], {"axis.torque": "pd.torque", "pd.angle": "axis.angle"}).worst.phase_margin

    Calls `flexfmu.cosim.design.margins.scene_margins.scene_margins`, and for a model `model_margins` there.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene; torques drive it, with controllers. Or a list as for
            `simulate`: a model from equations, and what samples around it.
        connections: of a list: ``slave.input`` → ``slave.output``.
        point: state or input of a model → value; the start value for others.
        poses: number of equally spaced poses along the path, in addition to the worst ones, which are searched; 1 for its end alone.
        payload_band: payloads among which the worst one is searched too, unknown to the controllers: a fraction to both sides,
            or the lightest and the heaviest [kg].
        identified: what `identify` found, or its ``identified.json``: margins are also those of robots at the edge of what it leaves likely,
            all estimates and their correlations taken together, unknown to the controllers.
        response: of the robot at the end of the path, or of the model's part about the point, measured, or its file. In its band it
            stands in place of the model's, in the same loop, and margins have standard errors, ``margins.worst.gain_margin.error``.
        parts: ``controllers``, ``shapers``, ``imperfections``, ``filters``, ``disturbances`` and ``connect`` as for `run`.

    Returns:
        Gain, phase and delay margin, disk margin, peak of the sensitivity and bandwidth for each pose and each cut, in SI units
        and rad.

    Raises:
        SceneError: the scene doesn't exist, or one of its keys or values is invalid.
        InputError: the scene has no loop, a slave can't be linearised, or sample times have no common period; or a list hasn't one model,
            or can't be connected; or the response lacks a signal of the loop.
        ResultsError: the response can't be read.
        ModelError: a name of the point is unknown, or the model gives no finite number there.
        TrajectoryError: the motion is not feasible.
        EquilibriumError: the robot has no static equilibrium at a pose.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.cosim.design.gains.robustness import band_masses
    from flexfmu.cosim.design.identification.result import identified_robots
    from flexfmu.cosim.design.margins.scene_margins import model_margins, scene_margins
    from flexfmu.cosim.design.response.response import as_response

    measured = as_response(response)
    if not isinstance(scene, str) and isinstance(scene, SymbolicModel | Sequence):
        if parts or payload_band is not None or identified is not None:
            raise InputError("bands, identified and parts are for scenes; controllers of a model are slaves beside it")
        return model_margins(
            [scene] if isinstance(scene, SymbolicModel) else scene, wires(connections), point or {}, measured
        )
    if connections or point:
        raise InputError("connections and point are for a loop around a model from equations")
    robot = resolved(with_parts(as_scene(scene), parts))
    masses = () if payload_band is None else band_masses(robot, payload_band)
    return scene_margins(
        robot, poses=poses, payloads=masses, robots=identified_robots(robot, identified), response=measured
    )


def frequency_response(
    log: Log | Run | Sequence[Log | Run],
    input: str | Sequence[str],
    output: str | Sequence[str],
    *,
    period: float | None = None,
    skip: int = 1,
    segment: float | None = None,
    reference: str | Sequence[str] = (),
    between: tuple[float, float] | None = None,
    band: tuple[float, float] | None = None,
    held: bool = True,
    mapping: Mapping[str, str] = MappingProxyType({}),
) -> FrequencyResponse:
    """Estimate a frequency response from logs of a robot or of runs, with standard errors and coherence.

        plant = flexfmu.frequency_response("log.csv", "joint1.torque", "joint1.position", period=2.0, band=(1.0, 200.0))
        plant.plot(), plant.modes(), flexfmu.margins("scene.toml", response=plant)

    Periodic excitation (a multisine, a repeated chirp) is averaged over its periods, anything else by Welch's method under a Hann window.
    In a closed loop an input that a controller feeds back isn't independent of noise: with periodic excitation that averages out, else
    name the ``reference`` that excites the loop. Calls `flexfmu.cosim.design.response.estimate.estimate_response`.

    Args:
        log: a CSV, ``.mat`` or ``.parquet`` file, a recording, a data frame, or a run; or a list of them, experiments of the same
            system. As many experiments as inputs, each exciting another one, tell inputs apart; one does with independent noise.
        input, output: name or names of signals; a sum is one signal, called like its first term,
            ``"joint1.torque + joint1.disturbance"``.
        period: [s] of the excitation; None for Welch's method. The last whole periods of a log are taken.
        skip: number of periods that are left out at least, for the transient.
        segment: length [s] of Welch's segments, which overlap by half; by default eight of them cover a log.
        reference: name or names of the excitation, as instruments.
        between: first and last instant [s] of what is taken of each log.
        band: lowest and highest frequency [Hz].
        held: whether the input is held between samples, as a controller's torque is: then the response is that of held values. A log
            that is resampled, since its steps aren't equal, gives one of continuous signals.
        mapping: column of the logs → ``signal*factor+offset``, as for `identify`.

    Returns:
        The response at the excited frequencies.

    Raises:
        ResultsError: a log can't be read.
        InputError: a signal doesn't exist or has no number, a log is too short, or nothing is excited.
    """
    from flexfmu.cosim.design.response.estimate import estimate_response
    from flexfmu.cosim.engine.measured import as_mapped

    logs = log if isinstance(log, Sequence) and not isinstance(log, str) else [log]
    several = [[each] if isinstance(each, str) else [*each] for each in (input, output, reference)]
    return estimate_response(
        logs, *several[:2], period=period, skip=skip, segment=segment, reference=several[2], between=between, band=band, held=held,
        mapping={column: as_mapped(text) for column, text in mapping.items()},
    )  # fmt: skip


def sweep(
    scene: SceneSource | SymbolicModel,
    cases: Mapping[str, Any] | Sequence[Mapping[str, Any]] | str | Path,
    *,
    metrics: Collection[str] | None = None,
    record: Collection[str] | None = None,
    record_step: float | None = None,
    sample: str | None = None,
    seed: int = 0,
    processes: int | None = None,
    out: str | Path | None = None,
    restart: bool = False,
    dask: str | None = None,
    progress: Progress | None = None,
    stop_time: float | None = None,
    step: float | None = None,
    tolerance: float = 1e-6,
    **parts: Unpack[Parts],
) -> SweepResult:
    """Simulate many variants of a scene and measure each.

        result = flexfmu.sweep("barnard2012-6kg", {"payload.mass": "0:8:9", "trajectory.duration": [0.3, 0.43]})
        result.to_pandas(), result.plot(), result.failed
        result = flexfmu.sweep(vdp, {"mu": "0.5:5:100"}, record=["x0"], stop_time=20.0, step=0.1)
        result.recording(7)["x0"].values

    Calls `flexfmu.cosim.studies.sweep.sweep.sweep_scene`, and for a model `flexfmu.cosim.studies.sweep.model_sweep.sweep_model`.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene; or a model from equations, whose outputs are recorded
            and whose parameters are varied, ``start.NAME`` among them.
        cases: key of the scene → list of values, or a text as ``--vary`` takes it, ``0:8:50``; all combinations are simulated.
            With ``sample`` a pair (from, to) is an interval. Or a list of changes, one dict for each case; or the path of a CSV
            file with keys in its first line.
        metrics: names of the metrics; None for all.
        record: names of signals that are kept for each case; None for none.
        record_step: interval of the kept signals [s]; None for every recorded instant.
        sample: ``lhs:1000`` (Latin hypercube) or ``sobol:1024`` (Sobol sequence) instead of all combinations.
        seed: seed of the sample.
        processes: number of processes; None for one on each processor.
        out: folder of the results, where every finished case is kept at once: the same call continues where it was
            interrupted. None for memory alone.
        restart: whether results of another sweep in the folder are discarded.
        dask: address of a Dask scheduler whose workers simulate, ``tcp://host:8786``.
        progress: function that is called with the finished fraction, 0 to 1.
        stop_time, step, tolerance: end [s], communication step [s] and relative tolerance for a model; a scene has its own.
        parts: ``controllers``, ``shapers``, ``imperfections``, ``filters``, ``disturbances`` and ``connect`` as for `run`.

    Returns:
        The cases as a sequence of dicts, with `to_pandas`, `plot`, `failed`, `summary` and `recording`. A case that fails has a
        message and no metrics.

    Raises:
        SceneError: the scene doesn't exist, a key is unknown, or a value is invalid in every case.
        InputError: the cases, a metric, the sample or the number of processes is invalid, the folder has another sweep, or a model gets
            what only scenes have.
        ResultsError: the folder can't be written or read.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.cosim.studies.sweep.cases import as_cases
    from flexfmu.cosim.studies.sweep.result import write_files
    from flexfmu.cosim.studies.sweep.sweep import ready_to_sweep, sweep_scene

    def show(done: int, total: int) -> None:
        if progress is not None:
            progress(done / total)

    if isinstance(scene, SymbolicModel):
        from flexfmu.cosim.studies.sweep.model_sweep import sweep_model

        scenes: dict[str, Any] = {
            "metrics": metrics,
            "record_step": record_step,
            "processes": processes,
            "dask": dask,
            **parts,
        }
        if given := [name for name, value in scenes.items() if value is not None]:
            raise InputError(f"{given[0]} is for scenes; a model's outputs are recorded at each step")
        if stop_time is None or step is None:
            raise InputError("a model needs its end and communication step [s]: stop_time=20.0, step=0.1")
        kept = None if record is None else listed(record, "record")
        varied = as_cases(cases, sample, seed)
        result = sweep_model(
            scene,
            varied,
            stop_time=stop_time,
            step=step,
            record=kept,
            tolerance=tolerance,
            folder=None if out is None else Path(out),
            restart=restart,
            show=show,
        )
        if out is not None:
            write_files(result, Path(out), plot=False)
        return result
    if stop_time is not None or step is not None:
        raise InputError("stop_time and step are for models from equations; a scene has its own, under [cosimulation]")
    folder = None if out is None else Path(out)
    robot = with_parts(as_scene(scene), parts)
    varied = as_cases(cases, sample, seed, robot)
    result = sweep_scene(
        ready_to_sweep(robot, varied, note=lambda text: warnings.warn(text, RunWarning, stacklevel=3)),
        varied,
        metrics=None if metrics is None else listed(metrics, "metrics"),
        record=None if record is None else Selection(listed(record, "record"), step=record_step),
        processes=processes,
        folder=folder,
        restart=restart,
        dask=dask,
        show=show,
    )
    if folder is not None:
        write_files(result, folder, plot=False)
    return result


def start_gains(
    scene: SceneSource,
    kind: Literal["pd", "pid", "cascade"],
    bandwidth: float,
    *,
    pose: Literal["start", "middle", "end"] = "end",
    sample_time: float | None = None,
) -> dict[str, Any]:
    """Return a controller whose gains give rigid joints a bandwidth, to start tuning from.

        scene = scene.replace({"controller": [flexfmu.start_gains(scene, "cascade", 10.0)]})

    Calls `flexfmu.cosim.design.gains.starts.start_controller`, whose module has the formulas.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene; torques drive the robot.
        kind: ``pd``, ``pid`` or ``cascade``.
        bandwidth: [Hz]; a tenth of the lowest natural frequency is a safe start.
        pose: where the joints' inertias are taken.
        sample_time: [s]; None for that of the scene's first controller, or 1 ms.

    Returns:
        The table of the controller, as in the scene file.

    Raises:
        SceneError: the scene doesn't exist, or one of its keys or values is invalid.
        InputError: the kind or the pose is unknown, the bandwidth isn't positive, or torques don't drive the robot.
        TrajectoryError: the motion is not feasible.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.cosim.design.gains.starts import start_controller

    driven = as_scene(scene).replace({"cosimulation.drive": "torque"})
    return start_controller(resolved(driven), kind, bandwidth, pose, sample_time)


def tune(
    scene: SceneSource,
    over: Mapping[str, Sequence[float] | str],
    minimise: str = "rms_tracking_error",
    subject_to: Sequence[str] = (),
    *,
    payload_band: float | tuple[float, float] | None = None,
    identified: Identification | str | Path | None = None,
    response: FrequencyResponse | str | Path | None = None,
    method: str = "gradient",
    trials: int | None = None,
    seed: int = 0,
    processes: int | None = None,
    out: str | Path | None = None,
    restart: bool = False,
    progress: Callable[[str, float | None], None] | None = None,
    **parts: Unpack[Parts],
) -> TuneResult:
    """Search gains and other keys of a scene that minimise a metric within limits.

        result = flexfmu.tune("loop.toml", {"pd.kp": (1e3, 1e5), "pd.kd": (10, 500)}, subject_to=["peak_torque < 80"])
        result.values, result.scene, result.to_pandas()

    Calls `flexfmu.cosim.design.gains.tuner.tune_scene`.

    Args:
        scene: a scene, the path of a scene file, or the name of a shipped scene.
        over: key → (from, to), the interval of its values in the unit of the key; logarithmic where its ends are positive and differ
            by a factor of 4 or more.
        minimise: name of a metric; of both joints the larger without a number at its end, ``rms_tracking_error``. Or a margin of `flexfmu.margins`.
        subject_to: conditions ``FIGURE < LIMIT`` or ``FIGURE > LIMIT``, in SI units or with a unit: ``settling_time < 20ms``.
        payload_band: payloads for which all metrics hold, which controllers, shapers and motion don't know: a fraction to both
            sides, or the lightest and the heaviest payload [kg]; None for the scene's alone.
        identified: what `identify` found, or its ``identified.json``: all metrics hold for robots at the edge of what it leaves likely, too.
        response: of the robot, measured, for margins as in `flexfmu.margins`; metrics remain those of the model.
        method: what improves the best of the first trials: ``gradient``, by differences of runs;
            ``sample`` makes first trials alone.
        trials: number of trials; None for some 50 for each key.
        seed: of the first trials.
        processes: number of processes of first trials and differences; None for one on each processor.
        out: folder for ``tuned.toml``, ``tune.csv`` and ``tune.json``, where every trial is kept at once: the same call continues
            where it was interrupted. None for memory alone.
        restart: whether the trials of another tuning in the folder are discarded.
        progress: function that is called with what is being done, and the finished fraction.
        parts: ``controllers``, ``shapers``, ``imperfections``, ``filters``, ``disturbances`` and ``connect`` as for `run`.

    Returns:
        The best trial, the scene with its values, and all trials; the best so far after Ctrl-C. ``result.is_feasible`` tells
        whether it keeps all limits.

    Raises:
        SceneError: the scene doesn't exist, a key is unknown, or an end of its interval is invalid.
        InputError: a figure, a condition, an interval or the method is invalid, or the folder has another tuning.
        BuildError: there is no C compiler.
        ResultsError: all trials failed, or a file can't be written.
        TypeError: ``scene`` is of another type.
    """
    from flexfmu.cosim.design.gains.tuner import tune_scene, write_tuned, write_tuning
    from flexfmu.cosim.design.identification.result import identified_robots
    from flexfmu.cosim.design.response.response import as_response

    folder = None if out is None else Path(out)
    robot = resolved(with_parts(as_scene(scene), parts))
    result = tune_scene(
        robot,
        over,
        minimise,
        subject_to,
        payload_band=payload_band,
        robots=identified_robots(robot, identified),
        response=as_response(response),
        method=method,
        trials=trials,
        seed=seed,
        processes=processes or os.cpu_count() or 1,
        folder=folder,
        restart=restart,
        show=progress or (lambda text, fraction: None),
    )
    if folder is not None:
        write_tuning(result, folder)
        write_tuned(result, folder / "tuned.toml", None if isinstance(scene, Scene) else scene)
    return result

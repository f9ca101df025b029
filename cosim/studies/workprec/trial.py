"""The scene under test with its motion, its sample instants and its reference; the measured points of a work-precision diagram, and the
curve through the best of them.

Trials with our own FMU and master: integrators, communication steps, orders of the inputs, coupling algorithms; and the fidelity
ladder: what leaving effects out costs in accuracy, and saves in time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.timing import fastest, fastest_in_turns
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.fmu_build.errors import BuildError
from flexfmu.model.scene.loop import SampledSection
from flexfmu.model.scene.schema import Scene

SAMPLING = 1e-3
"""Spacing of the instants at which positions are compared [s]."""

REFERENCE_TOLERANCE = 1e-12
REFERENCE_STEP = 2.5e-4


@dataclass(frozen=True, eq=False)
class SceneUnderTest:
    """A scene under test.

    Attributes:
        scene: the scene.
        motion: its planned motion.
    """

    scene: Scene
    motion: MotionPlan

    @property
    def stop(self) -> float:
        """End of motion and dwell [s]."""
        return self.motion.stop_time

    @cached_property
    def instants(self) -> RealArray:
        """(N,) whole multiples of `SAMPLING` up to the end [s], at which positions are compared."""
        count = int(self.stop / SAMPLING * (1.0 + 1e-12))
        return np.asarray(SAMPLING * np.arange(1, count + 1), dtype=np.float64)

    @cached_property
    def reference(self) -> RealArray:
        """(N, 2) positions of the end effector [m] by the FMU at `REFERENCE_TOLERANCE`."""
        prepared = PreparedScene(self.scene, communication_step=REFERENCE_STEP, tolerance=REFERENCE_TOLERANCE)
        return self.positions(completed(prepared.run()))

    @cached_property
    def scale(self) -> float:
        """Largest elastic deviation [m]: largest distance of the end effector from the rigid robot's."""
        rigid = self.motion.task.evaluate(self.instants, 0)[0]
        return float(np.linalg.norm(self.reference - rigid, axis=1).max())

    def positions(self, run: Run) -> RealArray:
        """(N, 2) positions of the end effector [m] of a run at the instants that it communicates at, NaN elsewhere."""
        # the sample instants among the communication points
        time = run.recording.time
        index = np.searchsorted(time, self.instants * (1.0 - 1e-12) - 1e-15).clip(0, time.size - 1)
        position = np.stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"], axis=1)
        found: RealArray = position[index]
        found[np.abs(time[index] - self.instants) > 1e-9] = np.nan
        return found

    def error(self, positions: RealArray) -> float:
        """Largest distance from the reference, relative to `scale`; instants without a value don't count."""
        distance = np.linalg.norm(positions - self.reference, axis=1)
        return float(np.nanmax(distance)) / self.scale


def subject_of(scene: Scene) -> SceneUnderTest:
    """A scene with its planned motion, shapers included."""
    return SceneUnderTest(scene, loop_of(scene).motion)


def completed(run: Run) -> Run:
    """The run, if it came to its end.

    Raises:
        RunError: it ended early; the message is the run's.
    """
    if not run.completed:
        raise RunError(run.message)
    return run


class RunError(CosimError):
    """A run under test ended before its stop time."""


TOO_SLOW = 100.0
"""A sweep ends at a setting that takes this many times our time for its error."""

TINY = 1e-300
"""Error that stands for zero in logarithms."""

TrialSetting = TypeVar("TrialSetting")


@dataclass(frozen=True)
class WorkPrecisionTrial:
    """One setting of one line.

    Attributes:
        family: the question that it belongs to, for example ``integrators``.
        line: what is varied along a line, for example ``gauss4``.
        label: the setting, for example ``1e-5``.
        error: relative to the largest elastic deviation; None where the run failed.
        time: processor time of a run [s]; None where the run failed.
        note: why it failed, or a remark.
    """

    family: str
    line: str
    label: str
    error: float | None
    time: float | None
    note: str = ""

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.error is None


def trial_of(
    family: str,
    line: str,
    label: str,
    measure: Callable[[], tuple[float, float | None, str]],
    *failures: type[Exception],
) -> WorkPrecisionTrial:
    """One setting: error, processor time [s] and note as ``measure`` returns them, or why it failed.

    ``failures`` are errors of other tools beside ours.
    """
    known: tuple[type[Exception], ...] = (CosimError, BuildError, *failures)
    try:
        return WorkPrecisionTrial(family, line, label, *measure())
    except known as failure:
        return WorkPrecisionTrial(family, line, label, None, None, " ".join(str(failure).split()))


@dataclass(frozen=True)
class WorkCurve:
    """Processor time over error for one tool: its Pareto front.

    Attributes:
        trials: the settings that no other setting of the tool beats in both error and time, by ascending error.
    """

    trials: tuple[WorkPrecisionTrial, ...]

    @classmethod
    def of(cls, trials: Iterable[WorkPrecisionTrial]) -> WorkCurve:
        """The curve of all settings that were tried; failures and those that another one beats are left out."""
        good = [each for each in trials if each.error is not None and each.time is not None]
        # from the smallest error upwards, each setting that is faster than all before it
        best: list[WorkPrecisionTrial] = []
        for each in sorted(good, key=lambda each: (each.error, each.time)):
            if not best or (each.time or 0.0) < (best[-1].time or 0.0):
                best.append(each)
        return cls(tuple(best))

    @property
    def least(self) -> float:
        """Smallest error that was reached; infinite without any."""
        return self.trials[0].error or 0.0 if self.trials else np.inf

    @property
    def most(self) -> float:
        """Largest error of a setting that none beats; 0 without any."""
        return self.trials[-1].error or 0.0 if self.trials else 0.0

    def time(self, error: float) -> float | None:
        """Processor time [s] for at most this error, logarithms interpolated between two settings; None where no setting reached it."""
        if error < max(self.least, TINY):
            return None
        errors, times = (np.array([getattr(each, key) for each in self.trials]) for key in ("error", "time"))
        return float(np.exp(np.interp(np.log(error), np.log(np.maximum(errors, TINY)), np.log(times))))


def sweep(
    settings: Iterable[TrialSetting], run: Callable[[TrialSetting], WorkPrecisionTrial], ours: WorkCurve
) -> Iterator[WorkPrecisionTrial]:
    """Trials of another tool, the loosest setting first, until it is as accurate as our best or `TOO_SLOW` for its error."""
    for setting in settings:
        trial = run(setting)
        yield trial
        if trial.error is None or trial.time is None:
            continue
        # as accurate as our best setting, or much slower at the same error
        our_time = ours.time(trial.error)
        if trial.error <= ours.least < np.inf or (our_time is not None and trial.time >= TOO_SLOW * our_time):
            return


Announce = Callable[[str], None]
"""Function of a sentence on the current trial."""

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)

CONTROLLED = ("automatic", "gauss2", "gauss3", "gauss4", "radau3", "dopri5")
"""Integrators with error control."""

FIXED_STEPS = (1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
"""Fixed steps of the classical Runge-Kutta method [s]."""

STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
"""Communication steps [s]."""

ORDERS = (0, 1, 2, 3, 5, 9)
"""Degrees of the input polynomials: what a master can send, from values alone to two-point Hermite."""

TIGHT = 1e-10
"""Relative tolerance of the integrator in coupling trials."""


def integrator_trials(
    subject: SceneUnderTest,
    step: float,
    announce: Announce,
    controlled: Sequence[str] = CONTROLLED,
    fixed_steps: Sequence[float] = FIXED_STEPS,
) -> Iterator[WorkPrecisionTrial]:
    """Integrators over tolerances, and the classical one over fixed steps [s], at one communication step [s]."""
    for name in controlled:
        for tolerance in TOLERANCES:
            announce(f"{name}, tolerance {tolerance:.0e}")
            scene: dict[str, object] = {"cosimulation.integrator": name}
            options = {"communication_step": step, "tolerance": tolerance}
            yield fmu_trial(subject, "integrators", name, f"{tolerance:.0e}", scene, options)
    for fixed in fixed_steps:
        announce(f"rk4, step {fixed:g} s")
        scene = {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": fixed}
        yield fmu_trial(subject, "integrators", "rk4", f"{1e6 * fixed:g} µs", scene, {"communication_step": step})


def coupling_trials(subject: SceneUnderTest, announce: Announce) -> Iterator[WorkPrecisionTrial]:
    """Communication steps for each order of the input polynomials, with a tight tolerance of the integrator."""
    for order in ORDERS:
        for step in STEPS:
            announce(f"communication step {1e3 * step:g} ms, inputs of degree {order}")
            options = {"communication_step": step, "tolerance": TIGHT, "input_order": order}
            yield fmu_trial(subject, "communication", f"inputs of degree {order}", f"{1e3 * step:g} ms", {}, options)


def algorithm_trials(subject: SceneUnderTest, announce: Announce) -> Iterator[WorkPrecisionTrial]:
    """Coupling algorithms of the master over communication steps, for scenes with something to couple."""
    section = subject.scene.cosimulation
    samples = [each.sample_time for each in subject.scene.controller if isinstance(each, SampledSection)]
    for algorithm in ("gauss-seidel", "jacobi", "implicit"):
        for divisor in (1, 2, 4, 8):
            # steps divide the sample times
            step = min([section.communication_step, *samples]) / divisor
            announce(f"{algorithm}, communication step {1e3 * step:g} ms")
            scene: dict[str, object] = {"cosimulation.algorithm": algorithm}
            options = {"communication_step": step, "tolerance": 1e-9}
            yield fmu_trial(subject, "algorithms", algorithm, f"{1e3 * step:g} ms", scene, options)


def fmu_trial(
    subject: SceneUnderTest,
    family: str,
    line: str,
    label: str,
    changes: Mapping[str, object],
    options: Mapping[str, Any],
) -> WorkPrecisionTrial:
    """One co-simulation: its error, and the time of master, FMU and recording once all is loaded."""

    def measure() -> tuple[float, float, str]:
        scene = subject.scene.replace(dict(changes))
        prepared = PreparedScene(scene, motion=None if scene.shaper else subject.motion, **options)
        run = completed(prepared.run())
        statistics = run.health.statistics
        note = ", ".join(f"{statistics[key]} {key}" for key in ("steps", "evaluations") if key in statistics)
        return subject.error(subject.positions(run)), fastest(prepared.run), note

    return trial_of(family, line, label, measure)


RIGID: Mapping[str, object] = {
    "effects.proximal_bending": 0,
    "effects.proximal_axial": 0,
    "effects.distal_bending": 0,
    "effects.distal_axial": 0,
    "effects.quasi_static": [],
}

RICH: Mapping[str, object] = {
    "effects.basis": "craig-bampton",
    "effects.proximal_bending": 4,
    "effects.proximal_axial": 2,
    "effects.distal_bending": 3,
    "effects.distal_axial": 3,
    "effects.quasi_static": [],
}
"""The richest set, the reference of the ladder: all families, static and fixed-interface shapes until nothing changes any more."""


@dataclass(frozen=True)
class Rung:
    """A set of effects.

    Attributes:
        line: line of the diagram.
        label: name of the set.
        changes: changes of the rigid scene.
    """

    line: str
    label: str
    changes: Mapping[str, object]


def ladder() -> tuple[Rung, ...]:
    """Return the rungs of the fidelity ladder, from rigid links to more families of shapes."""
    # assumed modes, one family after the other
    bending = [{"effects.proximal_bending": k} for k in (1, 2, 3)]
    axial = bending[2] | {"effects.distal_axial": 3}
    both = axial | {"effects.distal_bending": 1}
    # static shapes need fewer coordinates
    static: dict[str, object] = {"effects.basis": "craig-bampton"}
    one_each = static | {"effects.proximal_bending": 1, "effects.distal_axial": 1}
    families = ["proximal_bending", "distal_axial"]
    return (
        Rung("assumed modes", "rigid", {}),
        Rung("assumed modes", "1 bending", bending[0]),
        Rung("assumed modes", "2 bending", bending[1]),
        Rung("assumed modes", "3 bending", bending[2]),
        Rung("assumed modes", "3 + 3 axial", axial),
        Rung("assumed modes", "3 + 3 + 1 distal bending", both),
        Rung("static shapes", "quasi-static 1 + 1", one_each | {"effects.quasi_static": families}),
        Rung("static shapes", "1 + 1 axial", one_each),
        Rung("static shapes", "1 + 1 + 1 distal bending", one_each | {"effects.distal_bending": 1}),
    )


def effect_trials(
    subject: SceneUnderTest, step: float, tolerance: float, announce: Announce
) -> Iterator[WorkPrecisionTrial]:
    """Every rung, its error against the richest set, its time in turns with the others; the scene's damping and loads stay."""
    announce("richest set of effects")
    options = {"communication_step": step, "tolerance": tolerance}
    # errors are relative to the richest set instead of the scene's own model
    rich = PreparedScene(subject.scene.replace(dict(RICH)), motion=subject.motion, **options)  # type: ignore[arg-type]
    truth = replace(subject)
    truth.__dict__["reference"] = subject.positions(completed(rich.run()))
    # errors first
    runs: list[tuple[WorkPrecisionTrial, PreparedScene]] = []
    ready: list[PreparedScene] = []
    for rung in ladder():
        announce(f"effects: {rung.line}, {rung.label}")

        def measure(rung: Rung = rung) -> tuple[float, None, str]:
            scene = truth.scene.replace({**RIGID, **rung.changes})
            ready.append(PreparedScene(scene, motion=truth.motion, **options))  # type: ignore[arg-type]
            positions = truth.positions(completed(ready[-1].run()))
            if np.isnan(positions).all():
                raise RunError("no positions")
            return truth.error(positions), None, ""

        trial = trial_of("effects", rung.line, rung.label, measure)
        if trial.failed:
            yield trial
        else:
            runs.append((trial, ready[-1]))
    # then times, in turns, so that load on the machine hits all rungs alike
    announce("effects: times")
    times = fastest_in_turns([prepared.run for _, prepared in runs])
    yield from (replace(trial, time=time) for (trial, _), time in zip(runs, times, strict=True))

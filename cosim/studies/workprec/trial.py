"""The scene under test with its motion, its sample instants and its reference; trials with our own FMU and master: integrators,
communication steps, orders of the inputs, coupling algorithms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.timing import fastest
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.fmu_build.errors import BuildError
from flexfmu.model.scene.loop import SampledSection
from flexfmu.model.scene.schema import Scene

SAMPLING = 1e-3
"""Spacing of the instants at which positions are compared [s]."""

REFERENCE_TOLERANCE = 1e-12
REFERENCE_STEP = 2.5e-4


Measured = tuple[float, float | None, str]
"""Error, processor time [s] and note of a trial."""

Announce = Callable[[str], None]
"""Function of a sentence on the current trial."""


@dataclass(frozen=True, eq=False)
class SceneUnderTest:
    """A scene under test.

    Attributes:
        scene: the scene.
        motion: its planned motion.
        announce: called with a sentence on each trial that begins.
        journal: where trials are kept.
    """

    scene: Scene
    motion: MotionPlan
    announce: Announce = lambda text: None
    journal: WorkJournal = NOWHERE

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

    def trial(
        self,
        family: str,
        line: str,
        label: str,
        measure: Callable[[], tuple[float, float | None, str]],
        *failures: type[Exception],
    ) -> WorkPrecisionTrial:
        """One setting: error, processor time [s] and note as ``measure`` returns them, or why it failed.

        ``failures`` are errors of other tools beside ours.
        """
        self.announce(f"{line}, {label}")
        known: tuple[type[Exception], ...] = (CosimError, BuildError, *failures)
        key, measured = (family, line, label), cast(Measured, ())
        try:
            # a failure to keep it is no failure of the trial
            measured = measured if key in self.journal else measure()
        except known as failure:
            return WorkPrecisionTrial(family, line, label, None, None, " ".join(str(failure).split()))
        return WorkPrecisionTrial(*key, *self.journal.kept(key, Measured, lambda: measured))


def subject_of(scene: Scene, announce: Announce = lambda text: None, journal: WorkJournal = NOWHERE) -> SceneUnderTest:
    """A scene with its planned motion, shapers included."""
    return SceneUnderTest(scene, loop_of(scene).motion, announce, journal)


def completed(run: Run) -> Run:
    """The run, if it came to its end.

    Raises:
        KeyboardInterrupt: the user has ended it.
        RunError: it ended early; the message is the run's.
    """
    if run.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    if not run.completed:
        raise RunError(run.message)
    return run


class RunError(CosimError):
    """A run under test ended before its stop time."""


TOO_SLOW = 100.0
"""A sweep ends at a setting that takes this many times our time for its error."""

TrialSetting = TypeVar("TrialSetting")


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


TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)

CONTROLLED = ("automatic", "gauss2", "gauss3", "gauss4", "radau3", "radau3-dense", "dopri5")
"""Integrators with error control."""

FIXED_STEPS = (1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
"""Fixed steps of the classical Runge-Kutta method [s]."""

STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4)
"""Communication steps [s]."""

ORDERS = (0, 1, 2, 3, 5, 9)
"""Degrees of the input polynomials: what a master can send, from values alone to two-point Hermite."""

TIGHT = 1e-10
"""Relative tolerance of the integrator in coupling trials."""


Setting = tuple[str, str, Mapping[str, object], Mapping[str, Any]]
"""Line and label of a setting of our FMU, changes of the scene, and options of `PreparedScene`."""


def integrator_settings(step: float) -> Iterator[Setting]:
    """Integrators over tolerances, and the classical one over fixed steps, at one communication step [s]."""
    for name in CONTROLLED:
        for tolerance in TOLERANCES:
            options = {"communication_step": step, "tolerance": tolerance}
            yield name, f"{tolerance:.0e}", {"cosimulation.integrator": name}, options
    for fixed in FIXED_STEPS:
        scene = {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": fixed}
        yield "rk4", f"{1e6 * fixed:g} µs", scene, {"communication_step": step}


def coupling_settings() -> Iterator[Setting]:
    """Communication steps for each order of the input polynomials, with a tight tolerance of the integrator."""
    for order in ORDERS:
        for step in STEPS:
            options = {"communication_step": step, "tolerance": TIGHT, "input_order": order}
            yield f"inputs of degree {order}", f"{1e3 * step:g} ms", {}, options


def algorithm_settings(scene: Scene) -> Iterator[Setting]:
    """Coupling algorithms of the master over communication steps that divide the sample times."""
    samples = [each.sample_time for each in scene.controller if isinstance(each, SampledSection)]
    for algorithm in ("gauss-seidel", "jacobi", "implicit"):
        for divisor in (1, 2, 4, 8):
            step = min([scene.cosimulation.communication_step, *samples]) / divisor
            options = {"communication_step": step, "tolerance": 1e-9}
            yield algorithm, f"{1e3 * step:g} ms", {"cosimulation.algorithm": algorithm}, options


def fmu_trials(subject: SceneUnderTest, family: str, settings: Iterable[Setting]) -> Iterator[WorkPrecisionTrial]:
    """Co-simulations: the error of each, and the time of master, FMU and recording once all is loaded."""
    for line, label, changes, options in settings:

        def measure(changes: Any = changes, options: Any = options) -> tuple[float, float, str]:
            scene = subject.scene.replace(dict(changes))
            prepared = PreparedScene(scene, motion=None if scene.shaper else subject.motion, **options)
            run = completed(prepared.run())
            statistics = run.health.statistics
            note = ", ".join(f"{statistics[key]} {key}" for key in ("steps", "evaluations") if key in statistics)
            return subject.error(subject.positions(run)), fastest(prepared.run), note

        yield subject.trial(family, line, label, measure)

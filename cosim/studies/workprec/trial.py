"""The scene under test with its motion, its sample instants and its reference; the measured points of a work-precision diagram, and
the curve through the best of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.prepared_scene import PreparedScene, Run
from flexfmu.cosim.experiment.scene_loop import loop_of
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


@dataclass(frozen=True)
class Curve:
    """Processor time over error for one tool: its Pareto front.

    Attributes:
        trials: the settings that no other setting of the tool beats in both error and time, by ascending error.
    """

    trials: tuple[WorkPrecisionTrial, ...]

    @classmethod
    def of(cls, trials: Iterable[WorkPrecisionTrial]) -> Curve:
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
    settings: Iterable[TrialSetting], run: Callable[[TrialSetting], WorkPrecisionTrial], ours: Curve
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

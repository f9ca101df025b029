"""What a process does for a sweep: it finds or builds the FMU of a group of cases once, and simulates shares of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.results import Column, Recording, Selection
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.scene_build import build_scene, scene_key
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.variants import Variant, VariantTask
from flexfmu.cosim.metrics.chosen import ChosenMetrics
from flexfmu.cosim.studies.sweep.cases import Cases, changes_of
from flexfmu.cosim.studies.sweep.groups import Group, Share
from flexfmu.fmu_build.batch_build import batch_library, lanes_of_processor
from flexfmu.fmu_build.cache import cache_folder, content_hash
from flexfmu.fmu_build.errors import BuildError, MissingCompilerError
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LONGEST = 400
"""Characters of a message; those that list all signals of a robot are longer."""


class Row(NamedTuple):
    """The result of a case.

    Attributes:
        number: of the case.
        values: of the metrics; None for no value.
        message: why the case failed; empty otherwise.
        recording: the signals that are kept; None for none.
    """

    number: int
    values: tuple[float | None, ...]
    message: str = ""
    recording: Recording | None = None


@dataclass(frozen=True)
class RecordedMetrics:
    """Metrics of a run, and some of its signals.

    Attributes:
        metrics: the metrics.
        record: which signals, and how often.
    """

    metrics: ChosenMetrics
    record: Selection

    def __call__(self, run: Run) -> tuple[dict[str, float | None], Recording]:
        """Measure a run.

        Raises:
            InputError: there is no such signal.
        """
        self.record.check(run.recording.columns)
        some = self.record.of(run.recording)
        return self.metrics(run), some if self.record.step is None else at_intervals(some, self.record.step)


def at_intervals(recording: Recording, step: float) -> Recording:
    """The recording at multiples of an interval [s] and at its end, by quintic Hermite interpolation; right limits at jumps."""
    time = recording.time
    count = int((time[-1] - time[0]) / step * (1.0 + 1e-12))
    instants = np.append(time[0] + step * np.arange(count + 1), time[-1])
    instants = instants[: -1 if time[-1] - instants[-2] <= 1e-9 * step else None]
    left = np.clip(time.searchsorted(instants * (1.0 + 1e-14), "right") - 1, 0, time.size - 2)
    # the last interval has a length, even where the end is there twice
    while np.any(flat := time[left + 1] == time[left]) and left[flat].min() > 0:
        left = np.where(flat, left - 1, left)
    return Recording(
        instants, {name: _interpolated(each, time, left, instants) for name, each in recording.columns.items()}
    )


def _interpolated(column: Column, time: RealArray, left: Any, instants: RealArray) -> Column:
    """A signal at instants in the intervals that begin at the indices ``left``; without derivatives it is held."""
    if column.first is None or column.second is None or column.texts is not None:
        return Column(column.unit, column.values[left], texts=column.texts)
    known = np.stack([column.values, column.first, column.second])
    found = hermite_derivatives(known[:, left], known[:, left + 1], time[left + 1] - time[left])
    # Taylor's sum from the left end
    after, values = instants - time[left], np.zeros(instants.size)
    for order in range(len(found) - 1, -1, -1):
        values = found[order] + values * after / (order + 1)
    return Column(column.unit, values)


@dataclass(frozen=True)
class Job:
    """All that a process needs to know of a sweep.

    Attributes:
        scene: the scene that is varied.
        cases: what varies.
        groups: cases with one FMU each.
        metrics: what is measured.
        record: signals that are kept; None for none.
    """

    scene: Scene
    cases: Cases
    groups: Sequence[Group]
    metrics: ChosenMetrics
    record: Selection | None = None
    _tasks: dict[int, VariantTask[Any] | Exception] = field(default_factory=dict, init=False, repr=False, compare=False)
    _lasting: set[str] = field(default_factory=set, init=False, repr=False, compare=False)

    def __reduce__(self) -> tuple[type[Job], tuple[Any, ...]]:
        """Without what is loaded, for other processes; they get the numbers of their cases with each share."""
        groups = [replace(each, numbers=()) for each in self.groups]
        return Job, (self.scene, self.cases, groups, self.metrics, self.record)

    def rows(self, share: Share) -> list[Row]:
        """The results of the cases of a share; those that fail have a message."""
        group, task = self.groups[share.group], self._task(share)
        found: dict[int, Row] = {}
        variants: dict[int, Variant] = {}
        for number in share.numbers:
            changes = changes_of(self.cases, number)
            try:
                variants[number] = group.variant(changes, self.scene.replace(changes))
            except SceneError as error:
                found[number] = self.failed(number, _reason(error))
        # by the FMU of the group; a robot that it can't be has its own
        outcomes = [task] * len(variants) if isinstance(task, Exception) else task.outcomes([*variants.values()])
        for number, outcome in zip(variants, outcomes, strict=True):
            if isinstance(outcome, InputError) and str(outcome) not in self._lasting:
                before, outcome = str(outcome), self._alone(number)
                # what its own FMU doesn't change, those of other cases don't either
                if isinstance(outcome, InputError) and str(outcome) == before:
                    self._lasting.add(before)
            found[number] = self._row(number, outcome)
        return [found[number] for number in share.numbers]

    def forget(self) -> None:
        """Unload the FMU."""
        self._tasks.clear()

    def _task(self, share: Share) -> VariantTask[Any] | Exception:
        """The task of a share's group with its FMU, kept until another group begins."""
        if share.group not in self._tasks:
            self._tasks.clear()
            group = self.groups[share.group]
            scene = self.scene if group.parameters is None else group.scene
            self._tasks[share.group] = self._built(scene, group.scene, together=len(share.numbers) > 1)
        return self._tasks[share.group]

    def _built(self, scene: Scene, robot: Scene, *, together: bool = False) -> VariantTask[Any] | Exception:
        """The task for variants of a scene, with the FMU of another that has the same effects."""
        measure = self.metrics if self.record is None else RecordedMetrics(self.metrics, self.record)
        try:
            with _one_builder(scene_key(robot)):
                path = build_scene(robot).path
                if together:
                    with contextlib.suppress(BuildError):
                        batch_library(path, lanes_of_processor())
        except MissingCompilerError:
            # no case can have an FMU
            raise
        except Exception as error:
            return error
        return VariantTask(scene, path, measure)

    def _alone(self, number: int) -> Any:
        """The outcome of a case with an FMU of its own."""
        scene = self.scene.replace(changes_of(self.cases, number))
        task = self._built(scene, scene)
        return task if isinstance(task, Exception) else task.outcomes([Variant({}, {})])[0]

    def _row(self, number: int, outcome: Any) -> Row:
        if isinstance(outcome, Exception):
            return self.failed(number, _reason(outcome))
        values, recording = outcome if isinstance(outcome, tuple) else (outcome, None)
        return Row(number, tuple(values[name] for name in self.metrics.names), "", recording)

    def failed(self, number: int, message: str) -> Row:
        """The row of a case that failed."""
        return Row(number, (None,) * len(self.metrics.names), message)


def _reason(error: Exception) -> str:
    """The message of an error in one line; with its type where it isn't one of ours."""
    text = shorten(str(error), LONGEST, placeholder=" ...")
    ours = type(error).__module__.startswith("flexfmu.")
    return text if ours and text else f"{type(error).__name__}: {text}"


@contextlib.contextmanager
def _one_builder(key: str) -> Iterator[None]:
    """A context that one process of this machine is in at a time for each key, so that an FMU isn't built twice at once.

    Where files can't be locked it may be.
    """
    path = cache_folder() / f"building-{content_hash([key.encode()])[:1]}.lock"
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(path.open("a"))
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX)
        yield

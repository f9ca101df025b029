"""The work of a sweep: which cases share an FMU and which are simulated side by side, which follows from the list of cases alone; and
what a process does for them: it finds or builds the FMU of a group of cases once, and simulates shares of them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from math import ceil
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np

from flexfmu.cosim.engine.dense_output import DenseOutput, resampled
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import locked
from flexfmu.cosim.engine.fmu.file import SYSTEM
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.cosim.experiment.planning import PLANNED_WITH
from flexfmu.cosim.experiment.recorded_instants import DERIVATIVES
from flexfmu.cosim.experiment.scene_build import build_scene, depends_on, scene_key
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.variants import DURATION, FEW, PeakMeasure, Variant, VariantTask, bands
from flexfmu.cosim.metrics.metrics import ChosenMetrics
from flexfmu.cosim.studies.sweep.cases import Cases
from flexfmu.fmu_build.batch_build import batch_library, lanes_of_processor
from flexfmu.fmu_build.cache import cache_folder, content_hash, make_private
from flexfmu.fmu_build.errors import BuildError, MissingCompilerError
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.keys import full_key
from flexfmu.model.scene.schema import Scene

MOVING = (*(f"mechanism.{key}" for key in PLANNED_WITH), "trajectory.start")
"""Parameters of the FMU that the planned motion depends on as well."""

LOOP = tuple(name for name, field in Scene.model_fields.items() if field.default == ())
"""Sections around the robot, which may depend on everything."""

SHARES, LEAST_SHARE = 32, 64
"""Shares of the cases that are simulated side by side, and the smallest number of cases in one."""

MOST_PEAKS, MOST_RECORDED = 1000, 250
"""Largest numbers of cases in a share, of which peaks alone are measured, or anything: half a second or a second of work."""


class Share(NamedTuple):
    """Cases that a process simulates at once.

    Attributes:
        group: number of their group.
        numbers: of the cases.
    """

    group: int
    numbers: Sequence[int]

    def parts(self) -> list[Share]:
        """Its cases one by one."""
        return [Share(self.group, (number,)) for number in self.numbers]


@dataclass(frozen=True)
class Group:
    """Cases that share an FMU.

    Attributes:
        numbers: of the cases.
        scene: the scene that the FMU is built from.
        parameters: key of the scene → FMU parameters that a case sets directly; None where each case is planned as a scene
            of its own, and the FMU gets all of its values.
    """

    numbers: Sequence[int]
    scene: Scene
    parameters: Mapping[str, tuple[str, ...]] | None

    def variant(self, changes: Mapping[str, Any], scene: Scene) -> Variant:
        """What a case changes in the group's scene (in the sweep's without ``parameters``); ``scene`` is that of the case."""
        if self.parameters is None:
            return Variant(changes, {})
        values: dict[str, float] = {}
        new: Any
        old: Any
        for key, names in self.parameters.items():
            new, old = (reduce(getattr, key.split("."), each) for each in (scene, self.scene))
            if not isinstance(new, tuple):
                new, old = (new,), (old,)  # numbers, not vectors
            values |= {name: a for name, a, b in zip(names, new, old, strict=True) if a != b}
        return Variant({key: value for key, value in changes.items() if not depends_on(key)}, values)


def groups_of(scene: Scene, cases: Cases) -> list[Group]:
    """The groups of cases that share an FMU."""
    own = scene_values(scene).values()
    known, has = {each.key for each in own}, {each.key for each in own if each.value}
    data = scene.model_dump(exclude_none=True)
    keys = [full_key(data, key) for key in cases.keys]
    whole = [key.partition("[")[0] for key in keys]
    # keys that are parameters of the FMU, and keys that need another FMU
    settable = [i for i, key in enumerate(whole) if key in known and depends_on(key)]
    building = [i for i, key in enumerate(keys) if depends_on(key) and i not in settable]
    members: dict[str, list[int]] = {}
    if building:
        for number, values in enumerate(cases.rows):
            members.setdefault(repr([values[i] for i in building]), []).append(number)
    # an effect that some case has must be in the FMU of all, also where the scene lacks it
    present: dict[str, Any] = {}
    for i in (i for i in settable if whole[i] not in has):
        there = (row[i] for row in cases.rows if np.any(row[i]) and not isinstance(row[i], str))
        if (value := next(there, None)) is not None:
            present[cases.keys[i]] = value
    found = []
    for numbers in members.values() if building else [range(len(cases))]:
        changes = cases.changes(numbers[0])
        other = {cases.keys[i]: changes[cases.keys[i]] for i in building if cases.keys[i] in changes}
        found.append(_group(scene, cases, numbers, other, present, [whole[i] for i in settable]))
    return found


def _group(
    scene: Scene,
    cases: Cases,
    numbers: Sequence[int],
    own: Mapping[str, Any],
    present: Mapping[str, Any],
    settable: Collection[str],
) -> Group:
    """A group of cases that differ in ``settable`` keys and in those without influence on the FMU."""
    for changes in ({**own, **present}, own, cases.changes(numbers[0])):
        try:
            built = scene.replace(dict(changes))
        except SceneError:
            continue
        # a motion that depends on nothing that varies, of a robot alone
        alone = not any(getattr(built, name) for name in LOOP) and not any(key.startswith(LOOP) for key in cases.keys)
        is_direct = built.cosimulation.drive == "motion" and alone and not any(key in MOVING for key in settable)
        if not is_direct:
            return Group(numbers, built, None)
        names: dict[str, tuple[str, ...]] = {}
        for name, each in scene_values(built).items():
            if each.key in settable:
                names[each.key] = (*names.get(each.key, ()), name)
        return Group(numbers, built, names)
    # each case tells what is wrong with it
    return Group(numbers, scene, None)


def shares_of(groups: Sequence[Group], cases: Cases, measure: Any, *, together: bool) -> Iterator[Share]:
    """Yield all cases in shares: many that are simulated side by side, all others alone.

    Args:
        groups: of the cases.
        cases: of the sweep.
        measure: what is measured of them.
        together: whether any may be simulated side by side.
    """
    peaks = isinstance(measure, PeakMeasure)
    largest = MOST_PEAKS if peaks else MOST_RECORDED
    for index, group in enumerate(groups):
        for band in _bands(group, cases, peaks) if together and group.parameters is not None else [group.numbers]:
            if len(band) < FEW or not together or group.parameters is None:
                yield from (Share(index, (number,)) for number in band)
                continue
            size = min(largest, max(LEAST_SHARE, ceil(len(band) / SHARES)))
            parts = ceil(len(band) / size)
            for i in range(parts):
                yield Share(index, band[i * len(band) // parts : (i + 1) * len(band) // parts])


def _bands(group: Group, cases: Cases, peaks: bool) -> Iterable[Sequence[int]]:
    """The cases of a group by motion; for peaks motions of one shape are together, in bands of similar durations."""
    places = {key: i for i, key in enumerate(cases.keys) if not depends_on(key)}
    if not places:
        return [group.numbers]

    def duration(number: int) -> Any:
        value = cases.rows[number][places[DURATION]]
        return group.scene.trajectory.duration if value is None else value

    def motion(number: int) -> dict[str, Any]:
        return {key: cases.rows[number][i] for key, i in places.items()}

    return bands(group.numbers, motion, duration if peaks and DURATION in places else None)


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
        some, step = self.record.of(run.recording), self.record.step
        if step is not None:
            # metrics need all communication points, those who look at the signals multiples of the interval
            begin, end = some.time[0], some.time[-1]
            instants = begin + step * np.arange(int((end - begin) / step) + 1)
            some = resampled(some, DenseOutput(some.time, instants, DERIVATIVES), 0)
        return self.metrics(run), some


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
            changes = self.cases.changes(number)
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
            if _is_of_machine(error):
                raise
            return error
        return VariantTask(scene, path, measure)

    def _alone(self, number: int) -> Any:
        """The outcome of a case with an FMU of its own."""
        scene = self.scene.replace(self.cases.changes(number))
        task = self._built(scene, scene)
        return task if isinstance(task, Exception) else task.outcomes([Variant({}, {})])[0]

    def _row(self, number: int, outcome: Any) -> Row:
        if isinstance(outcome, Exception):
            if _is_of_machine(outcome):
                raise outcome
            return self.failed(number, _reason(outcome))
        values, recording = outcome if isinstance(outcome, tuple) else (outcome, None)
        return Row(number, tuple(values[name] for name in self.metrics.names), "", recording)

    def failed(self, number: int, message: str) -> Row:
        """The row of a case that failed."""
        return Row(number, (None,) * len(self.metrics.names), message)


def _is_of_machine(error: Exception) -> bool:
    """Whether the machine has no space or files left: no result of a case, which succeeds when the sweep goes on."""
    cause = error if isinstance(error, OSError) else error.__cause__
    return isinstance(cause, OSError) and cause.errno in SYSTEM


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
            make_private(path.parent)
            stack.enter_context(locked(path, wait=True))
        yield

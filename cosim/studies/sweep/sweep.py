"""Sweeps a scene: values of its keys → cases → metrics of each, kept case by case."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.many.executor import DaskWorkers, Executor, Processes, finished, processors
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, LOOP_METRICS, MOTOR_METRICS
from flexfmu.cosim.metrics.metrics import ChosenMetrics, measuring
from flexfmu.cosim.studies.sweep.cases import Cases, Grid, Sample, Span, changes_of
from flexfmu.cosim.studies.sweep.result import SweepResult
from flexfmu.cosim.studies.sweep.store import FolderStore, MemoryStore, make_manifest, read_results
from flexfmu.cosim.studies.sweep.work import Job, Row, Share, groups_of, shares_of
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.keys import full_key, location, value_at
from flexfmu.model.scene.messages import unit_of
from flexfmu.model.scene.schema import Scene

ShowDone = Callable[[int, int], None]
"""Called with the number of finished cases and of all."""

CHECKED = 50
"""Number of values of a key that are checked before the sweep begins; of more, the first, the last and some between."""


def sweep_scene(
    scene: Scene,
    cases: Cases,
    *,
    metrics: Collection[str] | None = None,
    record: Selection | None = None,
    processes: int | None = None,
    folder: Path | None = None,
    restart: bool = False,
    dask: str | None = None,
    show: ShowDone = lambda done, total: None,
) -> SweepResult:
    """Simulate all cases and measure each; with a folder continue where an earlier call was interrupted.

    A case is the scene with its changes: cases that differ in parameters of the FMU or in the motion alone share an FMU, and many
    of them are simulated side by side, within the tolerance of a run of their own.

    Args:
        scene: the scene, its effects chosen.
        cases: what varies.
        metrics: names of the metrics; None for all.
        record: signals that are kept for each case, and their interval; None for none.
        processes: number of processes; None for one on each processor.
        folder: where results are kept; None for memory.
        restart: whether results of another sweep in the folder are discarded.
        dask: address of a Dask scheduler, whose workers simulate instead of processes.
        show: told how much is finished.

    Raises:
        SceneError: a key is unknown, or a value invalid in every case.
        InputError: a metric is unknown, the number of processes isn't positive, or the folder has another sweep.
        ResultsError: the folder can't be written or read.
    """
    count = processors() if processes is None else processes
    if not isinstance(count, int) or count < 1:
        raise InputError(f"a sweep needs a whole number of processes from 1 on, got {processes}")
    cases = _continuous(scene, cases)
    check_values(scene, cases)
    measure = measuring(default_metrics(scene) if metrics is None else list(dict.fromkeys(metrics)))
    _check_metrics(scene, cases, measure.names)
    units = _units(scene, cases, measure)
    job = Job(scene, cases, groups_of(scene, cases), measure, record)

    def begin() -> Executor[Share, list[Row]]:
        return Processes(job.rows, count, job.forget) if dask is None else DaskWorkers(job.rows, dask)

    # in memory
    if folder is None:
        memory = MemoryStore(len(cases), len(measure.names))
        _fill(memory, job, begin, show)
        return _result(job, memory, units, None)
    # in a folder
    head = ["case", *(_titled(name, units) for name in (*cases.keys, *measure.names)), "message"]
    with FolderStore(folder, cases, head, make_manifest(job, units), restart=restart) as store:
        _fill(store, job, begin, show)
        store.finish()
        return _result(job, read_results(folder, len(cases), len(measure.names)), units, folder)


def _fill(
    store: MemoryStore | FolderStore, job: Job, begin: Callable[[], Executor[Share, list[Row]]], show: ShowDone
) -> None:
    """Simulate what isn't finished."""
    total, done = len(job.cases), store.done
    show(done, total)
    if done == total:
        return

    def missing() -> Iterator[Share]:
        for share in shares_of(job.groups, job.cases, job.metrics, together=job.record is None):
            if not store.has(share.numbers):
                yield share

    def failed(share: Share, cause: str) -> list[Row]:
        return [job.failed(share.numbers[0], cause)]

    with closing(finished(begin(), missing(), Share.parts, failed)) as results:
        for rows in results:
            store.add(rows)
            show(store.done, total)


def _result(job: Job, found: MemoryStore, units: Mapping[str, str], folder: Path | None) -> SweepResult:
    return SweepResult(
        job.scene.name, job.cases, job.metrics.names, found.values, found.messages, units, found.recordings, folder
    )


def _continuous(scene: Scene, cases: Cases) -> Cases:
    """The cases, with whole numbers from intervals for those keys alone that have one in the scene: 0:8 kg are all masses up to 8 kg."""
    if not isinstance(cases, Sample):
        return cases
    data = scene.model_dump()
    values = [
        Span(float(each.low), float(each.high))
        if isinstance(each, Span) and type(value_at(data, key, f"scene {scene.name}")) is not int
        else each
        for key, each in zip(cases.keys, cases.values, strict=True)
    ]
    return replace(cases, values=tuple(values))


def default_metrics(scene: Scene) -> Collection[str]:
    """All metrics that the scene's robot has."""
    missing = set(LOOP_METRICS) if scene.cosimulation.drive == "motion" else set()
    missing |= set(MOTOR_METRICS) if scene.motor is None else set()
    return [name for name in ALL_METRICS if name not in missing]


def _check_metrics(scene: Scene, cases: Cases, names: Collection[str]) -> None:
    """Check that the robot has the metrics, unless cases have other drives and motors.

    Raises:
        InputError: it doesn't have one.
    """
    missing = [name for name in names if name not in default_metrics(scene)]
    if missing and not any(key.startswith(("cosimulation.drive", "motor")) for key in cases.keys):
        need = "a scene with `[motor]`" if missing[0] in MOTOR_METRICS else "a robot driven by torques"
        raise InputError(f"there is no metric {missing[0]!r} of this robot: it needs {need}")


def check_values(scene: Scene, cases: Cases) -> None:
    """Check each key and its values before anything is simulated; what only a combination makes invalid is the case's own error.

    Raises:
        SceneError: a key is unknown or there under two names, or a value is invalid by itself and in the cases that have it.
    """
    data = scene.model_dump(exclude_none=True)
    full = [full_key(data, key) for key in cases.keys]
    for place, key in enumerate(full):
        if key in full[:place]:
            raise SceneError(
                f"`{cases.keys[place]}` and `{cases.keys[full.index(key)]}` are the same key: give one of them"
            )
    for place, key in enumerate(cases.keys):
        for value, numbers in _some_values(cases, place):
            try:
                scene.replace({key: value})
            except SceneError as error:
                if not any(_is_valid(scene, cases, number) for number in numbers):
                    raise SceneError(str(error)) from None


def _is_valid(scene: Scene, cases: Cases, number: int) -> bool:
    try:
        scene.replace(changes_of(cases, number))
    except SceneError:
        return False
    return True


def _some_values(cases: Cases, place: int) -> list[tuple[Any, list[int]]]:
    """Values of a key, and some cases that have each."""
    if isinstance(cases, Sample) and isinstance(span := cases.values[place], Span):
        return [(span.low, []), (span.high, [])]
    if isinstance(cases, Grid):
        level = cases.levels[place]
        inner = len(Grid(cases.keys[place + 1 :], cases.levels[place + 1 :]))
        block = inner * len(level)
        found = [
            (each, [i * inner, i * inner + inner - 1, len(cases) - block + i * inner + inner // 2])
            for i, each in enumerate(level)
        ]
    else:
        where: dict[str, tuple[Any, list[int]]] = {}
        for number in range(len(cases)):
            value = cases[number][place]
            if value is not None:
                where.setdefault(repr(value), (value, []))[1].append(number)
        found = [(value, [*numbers[:2], numbers[-1]]) for value, numbers in where.values()]
    step = max(1, len(found) // CHECKED)
    return [*found[::step], *found[-1:]]


def _units(scene: Scene, cases: Cases, measure: ChosenMetrics) -> dict[str, str]:
    """Key or metric → unit."""
    data = scene.replace(changes_of(cases, 0)).model_dump() if _is_valid(scene, cases, 0) else scene.model_dump()
    found = {key: unit_of(location(data, key), Scene) for key in cases.keys}
    return found | {name: ALL_METRICS[name].unit for name in measure.names}


def _titled(name: str, units: Mapping[str, str]) -> str:
    """A heading with its unit."""
    return f"{name} [{units[name]}]" if units[name] else name

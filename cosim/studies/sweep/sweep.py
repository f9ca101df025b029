"""Sweeps a scene: values of its keys → cases → metrics of each, kept case by case."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.design.effects.accuracy import chosen_over
from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.many.executor import DaskWorkers, Executor, Processes, finished, processors
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, LOOP_METRICS, MOTOR_METRICS
from flexfmu.cosim.metrics.metrics import measuring
from flexfmu.cosim.studies.sweep.cases import Cases
from flexfmu.cosim.studies.sweep.result import Results, SweepResult
from flexfmu.cosim.studies.sweep.work import Job, Row, Share, groups_of, shares_of
from flexfmu.model.scene.effects import LOADS
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import file_digests
from flexfmu.model.scene.keys import full_key, location
from flexfmu.model.scene.messages import unit_of
from flexfmu.model.scene.schema import Scene

ShowDone = Callable[[int, int], None]
"""Called with the number of finished cases and of all."""

LOADED = ("effects.gravity", *(f"effects.{key}" for key in LOADS if "." not in key))
"""Keys of effects that belong to the robot."""

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
    check_values(scene, cases)
    measure = measuring(default_metrics(scene) if metrics is None else list(dict.fromkeys(metrics)))
    # the robot has these metrics, unless cases have other drives and motors
    missing = [name for name in measure.names if name not in default_metrics(scene)]
    if missing and not any(key.startswith(("cosimulation.drive", "motor")) for key in cases.keys):
        need = "a scene with `[motor]`" if missing[0] in MOTOR_METRICS else "a robot driven by torques"
        raise InputError(f"there is no metric {missing[0]!r} of this robot: it needs {need}")
    # by index, since a kind that varies may be what a key names its element by
    own, data = scene.model_dump(exclude_none=True), (_changed(scene, cases, 0) or scene).model_dump()
    units = {key: unit_of(location(data, full_key(own, key)), Scene) for key in cases.keys}
    units |= {name: ALL_METRICS[name].unit for name in measure.names}
    job = Job(scene, cases, groups_of(scene, cases), measure, record)
    # what is swept: another sweep doesn't continue this one
    manifest = {
        "flexfmu": version("flexfmu"),
        "scene": scene.model_dump(mode="json", exclude_none=True),
        **({"files": files} if (files := file_digests(scene)) else {}),
        "cases": cases.described(),
        "metrics": list(measure.names),
        "record": None if record is None else {"signals": list(record.names or ()), "step": record.step},
        "units": units,
    }

    def shares() -> Iterator[Share]:
        for share in shares_of(job.groups, cases, measure, together=record is None):
            if not found.finished[[*share.numbers]].all():
                yield share

    def failed(share: Share, cause: str) -> list[Row]:
        return [job.failed(share.numbers[0], cause)]

    with Results(cases, measure.names, units, folder, manifest, restart=restart) as found:
        done = int(found.finished.sum())
        show(done, len(cases))
        if done < len(cases):
            executor: Executor[Share, list[Row]]
            executor = Processes(job.rows, count, job.forget) if dask is None else DaskWorkers(job.rows, dask)
            with closing(finished(executor, shares(), Share.parts, failed)) as results:
                for rows in results:
                    found.add(rows)
                    show(int(found.finished.sum()), len(cases))
        found.finish()
    return SweepResult(
        scene.name, cases, measure.names, found.values, found.messages, units, found.recordings, folder, scene
    )


CORNER_KEYS = 3
"""Largest number of keys whose extremes are combined to corners."""


def ready_to_sweep(
    scene: Scene, cases: Cases, show: ShowProgress = quiet, note: Callable[[str], object] = lambda text: None
) -> Scene:
    """Return the scene with what it leaves open chosen; for the accuracy that it asks for, at the corners of the sweep too.

    Args:
        scene: what is swept.
        cases: what varies.
        show: called with the current activity and the finished fraction.
        note: called with a sentence for each corner at which the settings had to be tightened.

    Raises:
        SceneError: a key that the accuracy chooses is varied.
        As `flexfmu.cosim.design.effects.choice.resolved_with_answer`.
    """
    if not scene.accuracy:
        return resolved(scene, show)
    chosen = ("effects.", "cosimulation.step", "cosimulation.tolerance", "cosimulation.integrator", "accuracy")
    if twice := [key for key in cases.keys if key.startswith(chosen) and not key.startswith(LOADED)]:
        raise SceneError(f"`accuracy` chooses `{twice[0]}`, which is varied too: leave out one of them")
    # the cases that reach furthest towards each corner
    numbers = [
        place for place in range(len(cases.keys)) if all(isinstance(row[place], int | float) for row in cases.rows)
    ]
    numbers = numbers[:CORNER_KEYS]
    values = np.array([[row[place] for place in numbers] for row in cases.rows], dtype=float).reshape(len(cases), -1)
    values = (
        (values - values.min(axis=0)) / np.maximum(np.ptp(values, axis=0), np.finfo(float).tiny) if numbers else values
    )
    rows = {int(np.argmax(values @ np.array(signs))) for signs in product((-1.0, 1.0), repeat=len(numbers))}
    corners = {", ".join(f"{key} = {value}" for key, value in cases.changes(row).items()): row for row in sorted(rows)}
    return chosen_over(scene, {name: scene.replace(cases.changes(row)) for name, row in corners.items()}, show, note)


def default_metrics(scene: Scene) -> Collection[str]:
    """All metrics that the scene's robot has."""
    missing = set(LOOP_METRICS) if scene.cosimulation.drive == "motion" else set()
    missing |= set(MOTOR_METRICS) if scene.motor is None else set()
    return [name for name in ALL_METRICS if name not in missing]


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
        # some values, and some cases that have each
        where: dict[str, tuple[Any, list[int]]] = {}
        for number, row in enumerate(cases.rows):
            if row[place] is not None:
                where.setdefault(repr(row[place]), (row[place], []))[1].append(number)
        found = [*where.values()]
        for value, numbers in [*found[:: max(1, len(found) // CHECKED)], *found[-1:]]:
            try:
                scene.replace({key: value})
            except SceneError as error:
                if not any(_changed(scene, cases, number) for number in (*numbers[:2], numbers[-1])):
                    raise SceneError(str(error)) from None


def _changed(scene: Scene, cases: Cases, number: int) -> Scene | None:
    """The scene of a case; None if it is invalid."""
    try:
        return scene.replace(cases.changes(number))
    except SceneError:
        return None

"""What is compared: runs from memory, from folders and files of results, and scenes that are run now."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.prepared_scene import Run, run_scene
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, Measurement
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.comparison import ComparedRun
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    from flexfmu.cosim.choices.effects.choice import ShowProgress

Source = Run | Scene | Path | str
"""A run, a scene, or what a path leads to: a folder or file of results, a scene file; or the name of a shipped scene."""

READABLE = (".parquet", ".mat", ".csv")
"""Files of results that are read, in this order where a folder has several: with units first."""


def compared_runs(sources: Sequence[Source], show: ShowProgress = lambda text, fraction: None) -> list[ComparedRun]:
    """Return the runs with different names; scenes are simulated now, with errors from one companion run each.

    Raises:
        InputError: there is no source, or a folder has no results.
        ResultsError: a file can't be read, or a scene's run failed.
        SceneError, TrajectoryError, BuildError: a scene can't be run.
    """
    if not sources:
        raise InputError("there is nothing to compare; name at least one folder of results or scene")
    found = list[ComparedRun]()
    for source in sources:
        run = _compared(source, show)
        names = [each.name for each in found]
        number, name = 1, run.name
        while name in names:
            number += 1
            name = f"{run.name} ({number})"
        found.append(ComparedRun(name, run.recording, run.metrics, run.duration))
    return found


def _compared(source: Source, show: ShowProgress) -> ComparedRun:
    if isinstance(source, Run):
        return _measured(source)
    if isinstance(source, Scene):
        return _measured(_simulated(source, show))
    path = Path(source)
    if path.is_dir():
        file = next((path / f"results{suffix}" for suffix in READABLE if (path / f"results{suffix}").is_file()), None)
        if file is None:
            raise InputError(
                f"{path} has no results.csv, results.parquet or results.mat; write them with flexfmu run --out {path}"
            )
        return _read(file, path.resolve().name)
    if path.suffix in READABLE and path.is_file():
        return _read(path, path.resolve().parent.name if path.stem == "results" else path.stem)
    return _measured(_simulated(load_scene(source), show))


def _simulated(scene: Scene, show: ShowProgress) -> Run:
    if scene.effects.select is not None:
        from flexfmu.cosim.choices.effects.choice import resolved

        scene = resolved(scene, show)
    return run_scene(scene, progress=lambda fraction: show(f"simulating {scene.name}", fraction))


def _measured(run: Run) -> ComparedRun:
    """Return a run with its metrics and their errors; without metrics where too little was recorded for them.

    Raises:
        ResultsError: it failed.
    """
    if not run.completed:
        raise ResultsError(f"{run.scene.name} can't be compared, since its run failed: {run.message}")
    try:
        metrics: Mapping[str, Measurement] = measure_run(run)
    except (ResultsError, EquilibriumError):
        metrics = {}
    return ComparedRun(run.scene.name, run.recording, metrics, run.plan.duration)


def _read(file: Path, name: str) -> ComparedRun:
    """Return the run of a file, with metrics and units from ``summary.json`` beside it, if there is one."""
    recording, summary = Recording.read(file), _summary(file.with_name("summary.json"))
    units: Mapping[str, str] = summary.get("units", {})
    if any(name in units for name in recording.columns):
        columns = {
            name: Column(column.unit or units.get(name, ""), column.values, texts=column.texts)
            for name, column in recording.columns.items()
        }
        recording = Recording(recording.time, columns)
    errors = summary.get("errors", {})
    metrics = {
        name: Measurement(value, error=errors.get(name))
        for name, value in summary.get("metrics", {}).items()
        if name in ALL_METRICS
    }
    stop, scene = summary.get("health", {}).get("stop_time"), summary.get("scene", {})
    duration = None if stop is None or "trajectory" not in scene else stop - scene["trajectory"].get("dwell", 0.0)
    return ComparedRun(name, recording, metrics, duration)


def _summary(path: Path) -> Mapping[str, Any]:
    """Return the content of ``summary.json``; empty if there is none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ResultsError(f"can't read {path}: {error}") from error
    return found if isinstance(found, dict) else {}

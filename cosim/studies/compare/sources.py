"""What is compared: runs from memory, from folders and files of results, and scenes that are run now."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.gains.robustness import PayloadBand, band_masses, failure_of, robustness
from flexfmu.cosim.design.gains.trial import UnstableLoopError, loop_margins, margin_figures
from flexfmu.cosim.engine.errors import CosimError, InputError, ResultsError, SignalFileError
from flexfmu.cosim.engine.files import file_digest
from flexfmu.cosim.engine.measured import tell_odd
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.experiment.timing import processor_time
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, metric
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.comparison import BAND_METRICS, ComparedRun, OverBand
from flexfmu.cosim.reports.summary import instability
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.keys import parse_setting, split_values
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

Source = Run | Scene | Path | str
"""A run, a scene, or what a path leads to: a folder or file of results, a scene file; or the name of a shipped scene."""

QUICK = 1.0
"""Processor time [s] below which a run is repeated to measure it."""

READABLE = (".parquet", ".mat", ".csv")
"""Files of results that are read, in this order where a folder has several: with units first."""


def compared_runs(
    sources: Sequence[Source],
    show: ShowProgress = quiet,
    payload_band: PayloadBand | None = None,
    *,
    strict: bool = False,
) -> list[ComparedRun]:
    """Return the runs with different names; scenes are simulated now, with errors from one companion run each.

    A scene whose run fails or whose loop diverges has a message instead of metrics, as long as another one has some.

    Args:
        sources: runs, folders, files and scenes.
        show: is called with what is being done, and the finished fraction.
        payload_band: scenes are also run at both ends of this band of payloads; None to skip.
        strict: whether a value in a file that is no finite number is an error instead of left out.

    Raises:
        InputError: there is no source, a folder has no results, or a band of payloads can't be had.
        ResultsError: a file can't be read, or a run failed.
        SceneError, TrajectoryError, BuildError: a scene can't be run.
    """
    if not sources:
        raise InputError("there is nothing to compare; name at least one folder of results or scene")
    # bands are checked before anything is simulated
    chosen = [_loaded(source, show, strict) for source in sources]
    scenes = [each for each in chosen if isinstance(each, Scene)]
    if payload_band is not None:
        if not scenes:
            raise InputError(
                "a band of payloads needs a scene, which is run with each payload; results alone don't tell"
            )
        for scene in scenes:
            band_masses(scene, payload_band)
    found = list[ComparedRun]()
    for each in chosen:
        run = _simulated(each, show, payload_band) if isinstance(each, Scene) else each
        names = chain([run.name], (f"{run.name} ({number})" for number in count(2)))
        found.append(replace(run, name=next(name for name in names if name not in {each.name for each in found})))
    failed = [run for run in found if run.failure and not run.metrics]
    if len(failed) == len(found):
        raise ResultsError(f"{failed[0].name} can't be compared, since its run failed: {failed[0].failure}")
    return found


def given_sources(
    arguments: Sequence[str],
    variants: Sequence[str] = (),
    settings: Sequence[str] = (),
    load: Callable[[str, Mapping[str, Any]], Scene] = load_scene,
) -> list[Source]:
    """Return what arguments of the command stand for: scenes by their names and with changes, results as they are.

    Args:
        arguments: ``SCENE``, ``NAME=SCENE``, or a folder or file of results.
        variants: ``NAME:KEY=VALUE,KEY=VALUE``, the first scene with changes.
        settings: ``KEY=VALUE``, changes of all scenes.
        load: loads a scene with changes.

    Raises:
        SceneError: there is no such scene, or a key or value is invalid.
        InputError: a variant has another form, or there is no scene to vary.
    """
    changes = dict(map(parse_setting, settings))
    found = [_given(each, changes, load) for each in arguments]
    first = next((each for each in found if isinstance(each, Scene)), None)
    if first is None and (variants or changes):
        raise InputError("--variant and --set change a scene: give one, not results alone")
    for text in variants:
        name, _, values = text.partition(":")
        if not (name.strip() and values.strip()) or "=" in name:
            raise InputError(f"--variant takes NAME:KEY=VALUE, stiff:pd.kp=2e4,pd.kd=200 for example, got {text!r}")
        assert first is not None
        varied = dict(parse_setting(each) for each in split_values(values, "--variant"))
        found.append(first.replace({**varied, "name": name.strip()}))
    return found


def _given(argument: str, changes: Mapping[str, Any], load: Callable[[str, Mapping[str, Any]], Scene]) -> Source:
    """The scene of an argument, changed; results as they are."""
    path = Path(argument)
    if path.is_dir() or (path.suffix in READABLE and path.is_file()):
        return argument
    name, sign, source = argument.partition("=")
    if not sign or path.exists():
        return load(argument, changes)
    return load(source, {**changes, "name": name.strip()})


def _loaded(source: Source, show: ShowProgress, strict: bool) -> ComparedRun | Scene:
    """The run that a source has, or the scene that is to be run, its effects chosen."""
    if isinstance(source, Run):
        measured = _measured(source)
        return replace(measured, failure=failure_of(source) or _margins(source.scene, None)[1])
    if not isinstance(source, Scene):
        path = Path(source)
        if path.is_dir():
            there = [file for suffix in READABLE if (file := path / f"results{suffix}").is_file()]
            if not there:
                raise InputError(
                    f"{path} has no results.csv, results.parquet or results.mat; write them with flexfmu run --out {path}"
                )
            return _read(there[0], path.resolve().name, strict)
        if path.suffix in READABLE and path.is_file():
            return _read(path, path.resolve().parent.name if path.stem == "results" else path.stem, strict)
        source = load_scene(source)
    if source.is_open:
        source = resolved(source, show)
    return source


def _simulated(scene: Scene, show: ShowProgress, band: PayloadBand | None) -> ComparedRun:
    """Run a scene, measure it, and do so at both ends of a band of payloads."""
    prepared, begin = PreparedScene(scene), processor_time()
    prepared.check_size()
    run = prepared.run(progress=lambda fraction: show(f"simulating {scene.name}", fraction))
    taken = processor_time() - begin
    if run.completed and taken < QUICK:  # the first one loads what the next ones share
        begin = processor_time()
        run = prepared.run()
        taken = min(taken, processor_time() - begin)
    loop: dict[str, Metric] = {"cpu_time": metric("cpu_time", taken)}
    if reason := failure_of(run):
        return ComparedRun(scene.name, run.recording, {}, run.plan.duration, loop=loop, failure=reason)
    margins, reason = _margins(scene, band)
    found = replace(_measured(run), loop=loop | margins, failure=reason)
    if band is None:
        return found
    names = [name for name in BAND_METRICS if name in found.metrics]
    text = f"simulating {scene.name} with other payloads"
    masses = band_masses(scene, band)
    robots = {mass: {"payload.mass": mass} for mass in masses}
    return replace(
        found, band=OverBand(masses, *robustness(prepared, robots, names, lambda fraction: show(text, fraction)))
    )


def _margins(scene: Scene, band: PayloadBand | None) -> tuple[dict[str, Metric], str]:
    """The worst margins of a scene's loop with its own payload, and a message if it is unstable about a pose, be it with another one; none
    without a loop, and where it can't be linearised."""
    if scene.cosimulation.drive != "torque" or not scene.controller:
        return {}, ""
    try:
        found = margin_figures(loop_margins(scene, band).own)
    except UnstableLoopError as error:
        return {}, str(error)
    except (CosimError, TrajectoryError, EquilibriumError):
        return {}, ""
    return {name: each if isfinite(each) else metric(name, None) for name, each in found.items()}, ""


def _measured(run: Run) -> ComparedRun:
    """Return a run with its metrics and their errors; without metrics where too little was recorded for them.

    Raises:
        ResultsError: it failed.
    """
    if not run.completed:
        raise ResultsError(f"{run.scene.name} can't be compared, since its run failed: {run.message}")
    try:
        metrics: Mapping[str, Metric] = measure_run(run)
    except (ResultsError, EquilibriumError):
        metrics = {}
    return ComparedRun(run.scene.name, run.recording, metrics, run.plan.duration, run=run)


def _read(file: Path, name: str, strict: bool) -> ComparedRun:
    """Return the run of a file, with metrics and units from ``summary.json`` beside it, if there is one."""
    recording, path = _finite(Recording.read(file), file, strict), file.with_name("summary.json")
    summary: Mapping[str, Any] = {}
    try:
        summary = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    except (OSError, ValueError) as error:
        raise SignalFileError(f"can't read {path}: {error}") from error
    if summary.get("results", {}).get(file.name, digest := file_digest(file)) != digest:
        raise SignalFileError(
            f"{file} isn't of the run that {path.name} beside it describes: run it again, or remove {path.name} to compare "
            "signals alone"
        )
    units: Mapping[str, str] = summary.get("units", {})
    if any(name in units for name in recording.columns):
        columns = {
            name: Column(column.unit or units.get(name, ""), column.values, texts=column.texts)
            for name, column in recording.columns.items()
        }
        recording = Recording(recording.time, columns)
    errors = summary.get("errors", {})
    metrics = {
        name: metric(name, value, error=errors.get(name))
        for name, value in summary.get("metrics", {}).items()
        if name in ALL_METRICS
    }
    stop, scene = summary.get("health", {}).get("stop_time"), summary.get("scene", {})
    duration = None if stop is None or "trajectory" not in scene else stop - scene["trajectory"].get("dwell", 0.0)
    failure = instability(summary.get("health", {}))
    return ComparedRun(name, recording, metrics, duration, failure=failure)


def _finite(recording: Recording, file: Path, strict: bool) -> Recording:
    """The signals of a file without values that are no finite numbers, which are told by their lines, or refused."""
    odd, columns, first = list[tuple[int, str, str]](), dict(recording.columns), 2 if file.suffix == ".csv" else 1
    for name, column in recording.columns.items():
        places = np.flatnonzero(~np.isfinite(column.values))
        if places.size and column.texts is None:
            odd += [(first + i, name, f"{column.values[i]:g}") for i in places.tolist()]
            columns[name] = Column(column.unit, np.where(np.isfinite(column.values), column.values, np.nan))
    tell_odd(file, odd, strict=strict)
    return Recording(recording.time, columns) if odd else recording

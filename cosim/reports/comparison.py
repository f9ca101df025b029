"""The page that compares runs: metrics side by side, their signals over each other, and spectra of what rings after the motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metric_table import (
    ALL_METRICS,
    LOOP_FIGURES,
    OF_BOTH,
    definition,
    display,
    larger,
    without_noise,
)
from flexfmu.cosim.reports.page import FIRST_METRICS, TILES, Figure, Page, Plot, Table
from flexfmu.cosim.reports.plots import Shown, signal_plots
from flexfmu.cosim.reports.report import of_scene
from flexfmu.cosim.reports.spectrum import spectrum, spectrum_caption

ALL = "Of all runs that have it."

# fmt: off
SIGNALS: Sequence[Shown] = [
    (f"compared-{number}", title, caption, factor, {f"{name}\n[{unit}]": {of: name} for name, of in signals.items()})
    for number, (title, unit, factor, signals, caption) in enumerate((
        ("Motor torques", "N·m", 1.0, {f"joint {i}": f"joint{i}.torque" for i in "12"}, ALL),
        ("Joint angles", "rad", 1.0, {f"joint {i}": f"joint{i}.position" for i in "12"}, ALL),
        ("Position of the end effector", "m", 1.0, {each: f"end_effector.position.{each}" for each in "xy"}, ALL),
        ("Acceleration of the end effector", "m/s²", 1.0, {each: f"end_effector.acceleration.{each}" for each in "xy"}, ALL),
        ("Tip deflections", "mm", 1e3, {f"link {i}": f"link{i}1.tip_deflection" for i in "12"}, ALL),
        ("Position error", "mm", 1e3, {"error": "deviation"}, "Distance of the end effector from the rigid robot's at the same time."),
        ("Spectra of the residual vibration", "µm", 1e6, {each: f"spectrum {each}" for each in "xy"},
         spectrum_caption("Position of the end effector after the end of the motion")),
    ))
]
# fmt: on
"""The plots of several runs, see `_values`."""

BEYOND = 1.5
"""Distance from their middle up to which a run that failed is drawn, relative to the range of the others."""

RANKS = {
    "residual_vibration_amplitude": "has the least residual vibration",
    "peak_torque": "has the smallest peak torque",
}
"""Metric → what the run with the smallest value does."""

TILE_RUNS = 2
"""Runs whose values stand there."""

BAND_METRICS = (
    "peak_torque_1",
    "peak_torque_2",
    "rms_torque_1",
    "rms_torque_2",
    "rms_tracking_error_1",
    "rms_tracking_error_2",
    "peak_position_error",
    "residual_vibration_amplitude",
    "settling_time",
)
"""Metrics that are compared over a band of payloads."""


@dataclass(frozen=True)
class OverBand:
    """A loop at both ends of a band of payloads.

    Attributes:
        masses: lightest and heaviest payload of the robot [kg].
        worst: metric → its largest value at both ends; without a value where one end has no value, a loop that doesn't settle for example.
        failures: payload that the run failed with [kg] → message.
    """

    masses: tuple[float, float]
    worst: Mapping[str, Metric]
    failures: Mapping[float, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ComparedRun:
    """A run, or a measurement, of a comparison.

    Attributes:
        name: short, unique.
        recording: its signals; what isn't recorded isn't compared.
        metrics: name → metric, as `flexfmu.cosim.metrics.metrics.measure_run` has them; none for a measurement.
        duration: end of the motion [s], from which spectra are taken; None if unknown.
        loop: further figures, of `LOOP_FIGURES`.
        band: the same loop with other payloads; None if it wasn't run with them.
        failure: why the run failed or its loop diverged; empty otherwise.
        run: the run itself; None for results that were read.
    """

    name: str
    recording: Recording = field(repr=False)
    metrics: Mapping[str, Metric] = field(default_factory=dict, repr=False)
    duration: float | None = None
    loop: Mapping[str, Metric] = field(default_factory=dict, repr=False)
    band: OverBand | None = field(default=None, repr=False)
    failure: str = ""
    run: Run | None = field(default=None, repr=False, compare=False)

    def metric(self, name: str) -> Metric:
        """A metric, of `OF_BOTH` that of the joint or leg with the larger value; without a value where it has none."""
        return self.metrics.get(larger(name, self.metrics), Metric(None))


def comparison_page(runs: Sequence[ComparedRun], tables: Sequence[Table], plots: Sequence[Plot]) -> Page:
    """Return the page that compares runs.

    Args:
        runs: at least one; differences are relative to the first.
        tables: of metrics, loops, and what else there is.
        plots: those of `compared_plots`, and others.
    """
    verdict = [*_ranks(runs), f"{len(runs)} runs, each in its colour; differences are relative to {runs[0].name}."]
    title = " · ".join(run.name for run in runs)
    shown = [(each.run.scene, each.run, place) for place, each in enumerate(runs) if each.run is not None]
    frame = of_scene(*shown[0]) if shown else {}
    return Page(title, verdict, plots, tables, first_tiles(runs), **frame)


def first_tiles(runs: Sequence[ComparedRun]) -> list[tuple[str, Sequence[str]]]:
    """Return what each of the main figures is, and its values of the first runs."""
    tiles = list[tuple[str, Sequence[str]]]()
    said = {part for name in FIRST_METRICS for part in OF_BOTH.get(name, [name])}
    for name in (*FIRST_METRICS, *(each for each in ALL_METRICS if each not in said)):
        found = [run.metric(name) for run in runs[:TILE_RUNS]]
        if any(each.value is not None for each in found) and len(tiles) < TILES:
            shown = [Figure.of(name, each.value, run=i, digits=4, error=each.error) for i, each in enumerate(found)]
            tiles.append((definition(name).label, shown))
    return tiles


def _ranks(runs: Sequence[ComparedRun]) -> Iterator[str]:
    """Which runs are worth nothing, and which of the others has the smallest residual vibration and the smallest peak torque."""
    names, failed = [run.name for run in runs], [place for place, run in enumerate(runs) if run.failure]
    text = f"Unstable or failed: {', '.join(names[place] for place in failed)}. " if failed else ""
    yield Figure.said(text, "failures", is_over=bool(failed), names=names, failed=failed)
    for name, text in RANKS.items():
        known = {run.name: without_noise(name, run.metric(name).value) for run in runs if not run.failure}
        values = {run: value for run, value in known.items() if value is not None}
        if len({*values.values()}) > 1:
            best = min(values, key=values.__getitem__)
            found = f"{best} {text}, {display(name, values[best], 3)}. "
            info = definition(name)
            facts: dict[str, Any] = {"factor": info.displayed(1.0), "unit": info.display_unit, "phrases": text}
            yield Figure.said(found, "least", parts=OF_BOTH.get(name, [name]), names=names, **facts)


def _rows(
    names: Iterable[str],
    found: Sequence[Mapping[str, Metric]],
    cell: Callable[[str, int, Metric], str],
    *,
    has_unit: bool,
) -> Iterator[list[str]]:
    """Yield label, with its unit if the cells are without it, name and cells of each metric that one has, by its place and value."""
    for name in names:
        if any(name in each for each in found):
            info = definition(name)
            unit = f" [{info.display_unit}]" if has_unit and info.display_unit else ""
            cells = (cell(name, place, each.get(name, Metric(None))) for place, each in enumerate(found))
            yield [f"{info.label}{unit}", name, *cells]


def loop_tables(runs: Sequence[ComparedRun]) -> Iterator[Table]:
    """Yield margins and processor times, the worst over a band of payloads, and what failed; each where a run has it."""
    bands = {run.name: run.band for run in runs if run.band}

    def rounded(name: str, found: Metric, digits: int) -> str:
        return "–" if found.value is None else f"{definition(name).displayed(found):.{digits}g}"

    def worst(name: str, place: int, found: Metric) -> str:
        failures = [*bands.values()][place].failures
        return "unstable" if found.value is None and failures else rounded(name, found, 5)

    rows = [
        *_rows(LOOP_FIGURES, [run.loop for run in runs], lambda name, _, found: rounded(name, found, 3), has_unit=True)
    ]
    if rows:
        yield Table("Loops", ["Figure", "Name", *(run.name for run in runs)], rows)
    if bands:
        rows = [*_rows(BAND_METRICS, [band.worst for band in bands.values()], worst, has_unit=True)]
        rows.append(["Payloads [kg]", "", *(f"{band.masses[0]:g}, {band.masses[1]:g}" for band in bands.values())])
        note = "The largest value with both payloads; controllers, shapers and motion are those for the scene's."
        yield Table("Worst with other payloads", ["Metric", "Name", *bands], rows, note)
    if rows := [[run.name, run.failure] for run in runs if run.failure]:
        yield Table("Unstable or failed", ["Run", "Why"], rows, texts=1)


def metrics_table(runs: Sequence[ComparedRun]) -> Table:
    """Return the metrics of runs side by side, each with its difference from the first run's in percent."""

    def cell(name: str, run: int, found: Metric) -> str:
        base = runs[0].metric(name).value if run else None
        return Figure.of(name, found.value, run=run, error=found.error, base=base)

    rows = [*_rows(ALL_METRICS, [run.metrics for run in runs], cell, has_unit=False)]
    note = "Values have the digits that their numerical errors allow. In brackets: difference from the first run."
    return Table("Metrics", ["Metric", "Name", *(run.name for run in runs)], rows, note)


def compared_plots(runs: Sequence[ComparedRun]) -> Iterator[Plot]:
    """Yield a plot for each group of signals that a run has, then the spectra."""
    # the end of the motion, if all runs that say so have the same
    ends = {run.duration for run in runs if run.duration is not None}
    dwells = [float(run.recording.time[-1]) - run.duration for run in runs if run.duration is not None]
    end, window = ends.pop() if len(ends) == 1 else np.nan, min(dwells, default=np.inf) or np.inf
    return signal_plots(SIGNALS, [run.name for run in runs], lambda of: _near(runs, of), end, window)


def _near(runs: Sequence[ComparedRun], of: str) -> Sequence[tuple[RealArray, RealArray] | None]:
    """Return what a curve of each run shows; of one that failed what is near the others."""
    found = [_values(run, of) for run in runs]
    known = [each[1] for each, run in zip(found, runs, strict=True) if each and each[1].size and not run.failure]
    if not known or of.startswith("spectrum"):
        return found
    low, high = (float(pick([float(pick(each)) for each in known])) for pick in (np.nanmin, np.nanmax))
    for number, (run, each) in enumerate(zip(runs, found, strict=True)):
        if each and run.failure:
            is_near = abs(each[1] - 0.5 * (low + high)) <= BEYOND * (high - low)
            found[number] = each[0], np.where(is_near, each[1], np.nan)
    return found


def _values(run: ComparedRun, of: str) -> tuple[RealArray, RealArray] | None:
    """Return what a curve shows, as ``Result.curve`` of simulation.js: a recorded signal, the distance of the end effector from the rigid
    robot's, or a spectrum of its position after the motion; None where it wasn't recorded, or for too short a time."""
    time, columns, position = run.recording.time, run.recording.columns, "end_effector.position."
    if of == "deviation":
        pairs = [(f"{position}{axis}", f"end_effector.reference.position.{axis}") for axis in "xy"]
        if not all(name in columns for pair in pairs for name in pair):
            return None
        return time, np.hypot(*(columns[one].values - columns[other].values for one, other in pairs))
    if of.startswith("spectrum"):
        name = f"{position}{of[-1]}"
        return (
            None if run.duration is None or name not in columns else spectrum(time, columns[name].values, run.duration)
        )
    return (time, columns[of].values) if of in columns else None

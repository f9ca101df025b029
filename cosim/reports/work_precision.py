"""Work-precision diagrams of a page: error to the right, time upwards, a line for each method, failures as crosses; every point shows its
setting, error, time and remarks. The report of a run with ``[accuracy]`` has one for each figure, of the settings that were tried."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.accuracy import AccuracyAnswer, WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.metrics.metric_table import definition
from flexfmu.cosim.reports.chart import INK, Curve, Marker, Panel, look
from flexfmu.cosim.reports.page import Plot

HEIGHT = 320.0
"""Of a diagram [pt]."""

FLOOR = 1e-12
"""Errors below are drawn here: the references agree no better."""

ACCURACY = "accuracy-"
"""Begins the keys of the diagrams of a report."""

FRONT = "cheapest of all"
"""Line of the settings that none beats in both error and time."""

TRIED = "Time of a run over the bound of the error, of the settings that were tried; dashed: what was asked."
"""Caption of the diagrams of a report."""

Lines = Mapping[str, Sequence[WorkPrecisionTrial]]
"""Line → its trials."""


def points(trials: Sequence[WorkPrecisionTrial]) -> RealArray:
    """Error and time [ms] of each trial, (n, 2)."""
    return np.array([(max(each.error or 0.0, FLOOR), 1e3 * (each.time or 0.0)) for each in trials]).reshape(-1, 2)


def by_line(trials: Iterable[WorkPrecisionTrial]) -> dict[str, list[WorkPrecisionTrial]]:
    """Line → its trials, in their order."""
    known = [*trials]
    return {line: [each for each in known if each.line == line] for line in dict.fromkeys(each.line for each in known)}


def fronts(trials: Sequence[WorkPrecisionTrial]) -> dict[str, list[WorkPrecisionTrial]]:
    """Line → those of its settings that none of it beats, and its failures; and the front of all."""
    lines = by_line(trials)
    found = {line: [*WorkCurve.of(each).trials, *(one for one in each if one.failed)] for line, each in lines.items()}
    return found | {FRONT: list(WorkCurve.of(trials).trials)}


def diagram(
    key: str,
    texts: tuple[str, str, str],
    lines: Lines,
    duration: float,
    marks: Sequence[tuple[float, str]] = (),
    markers: Sequence[Marker] = (),
) -> Plot:
    """Return a diagram of a page.

    Args:
        key: unique within the page.
        texts: title, caption, and label of the horizontal axis.
        lines: what is drawn.
        duration: simulated time [s].
        marks: errors at which dashed lines are drawn, and their texts.
        markers: texts, and settings that stand out; others aren't joined by lines then.
    """
    # the axes reach to the markers as well
    x, y = np.array([(each.x, each.y) for each in markers]).reshape(-1, 2).T
    curves = [Curve(x, y, width=0.0, is_read=False)]
    for number, (line, trials) in enumerate(lines.items()):
        shown = look(number) | ({"colour": INK} if line == FRONT else {})
        good, failed = ([each for each in trials if each.failed is wanted] for wanted in (False, True))
        place = points(good)
        notes = [f"{each.label}: {duration / (each.time or 1.0):.3g} times real time. {each.note}" for each in good]
        width = 0.0 if any(each.size for each in markers) and line != FRONT else 1.4
        curves.append(Curve(place[:, 0], place[:, 1], line, width=width, dot="disc", notes=notes, **shown))
        # what failed, at real time and an error of 1
        if failed:
            ones, notes = np.ones(len(failed)), [f"{each.label} failed: {each.note}" for each in failed]
            times = 1e3 * duration * ones
            curves.append(Curve(ones, times, f"{line}, failed", shown["colour"], width=0.0, dot="cross", notes=notes))
    title, caption, x_label = texts
    panel = Panel(label="time [ms]", curves=curves, markers=markers, logarithmic="xy", is_function=False, marks=marks)
    return Plot(key, title, caption, (panel,), x_label, HEIGHT)


def tried_settings(answer: AccuracyAnswer, duration: float) -> Iterator[Plot]:
    """Yield a diagram for each figure of an accuracy: all settings that were tried; the chosen, the scene's own and the dearest are marked."""
    for figure in answer.figures:
        size, own = abs(figure.value) or 1.0, answer.default
        trials = [each for each in answer.tried if each.family == figure.name]
        marked = [
            (figure.total / size, answer.chosen.time, "chosen"),
            (figure.reference / size, answer.dearest.time, "dearest"),
            *((each.error or 0.0, own.time, "default") for each in trials if own is not None and each.time == own.time),
        ]
        markers = [
            Marker(max(error, FLOOR), 1e3 * time, 11.0, INK, 0.35, "square", text, (0.0, -9.0), "middle")
            for error, time, text in marked
        ]
        lines = by_line(trials) | {FRONT: list(WorkCurve.of(trials).trials)}
        title = f"{definition(figure.name).label}: what its accuracy costs"
        beside = "error beside the richest model"
        label = f"relative {beside}" if figure.value else f"{beside} [{figure.unit}]"
        marks = [(figure.allowed / size, "asked")]
        yield diagram(f"{ACCURACY}{figure.name}", (title, TRIED, label), lines, duration, marks, markers)

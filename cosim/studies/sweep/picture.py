"""The picture of a sweep: lines over one key, heat maps over two, parallel coordinates over more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from numbers import Real
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.reports.figure_style import draw, style
from flexfmu.cosim.studies.sweep.cases import short_text, text_of

MOST_LINES = 2000
"""Cases that parallel coordinates show; of more, equally many are left out between them."""

PANELS = 12
"""Metrics that have a panel of their own; of more, the first."""

AXES = 4
"""Metrics that have an axis in parallel coordinates; the first gives the colours."""

COLOURS = "viridis"
"""From small to large values, also for those who don't see all colours, and in print."""


def draw_cases(title: str, keys: Mapping[str, Sequence[Any]], metrics: Sequence[str], values: RealArray) -> Figure:
    """The metrics over the varied keys.

    One key: a panel with a line for each metric. Two: a heat map of each, or points where the cases are no grid. More: parallel
    coordinates with an axis for each key and the first metrics; colours are those of the first. Failed cases are left out.

    Args:
        title: of the figure.
        keys: label of a key → its value in each of the N cases.
        metrics: labels of M metrics.
        values: (N, M), NaN where a case has no value.
    """
    varied = [_Axis(label, each) for label, each in keys.items() if len({*map(repr, each)}) > 1]
    shown = [(label, each) for label, each in zip(metrics, values.T, strict=True) if not np.isnan(each).all()][:PANELS]
    with style():
        if not shown or not varied:
            figure = draw(6.0, 2.0)
            figure.text(0.5, 0.5, "one case" if shown else "no case has a value to show", ha="center", va="center")
        elif len(varied) > 2:
            figure = draw(max(7.0, 1.6 * (len(varied) + min(AXES, len(shown)))), 4.5)
            _parallel(figure, varied, shown[:AXES])
        else:
            columns = min(3, len(shown))
            rows = ceil(len(shown) / columns)
            figure = draw(0.5 + 3.6 * columns, 0.3 + 2.7 * rows)
            for place, (label, each) in enumerate(shown, start=1):
                axes = figure.add_subplot(rows, columns, place)
                (_lines if len(varied) == 1 else _map)(axes, varied, each)
                axes.set_title(label, fontsize=8.5)
                axes.set_xlabel(varied[0].label)
                varied[0].mark(axes.xaxis)
        figure.suptitle(title)
    return figure


class _Axis:
    """The values of a key as numbers: themselves, or places in the list of its texts.

    Attributes:
        label: key and unit.
        values: (N,) positions.
        names: texts of the positions 0, 1, ...; empty for numbers.
    """

    def __init__(self, label: str, column: Sequence[Any]) -> None:
        self.label, self.names = label, list[str]()
        if all(isinstance(each, Real) and not isinstance(each, bool) for each in column):
            self.values: RealArray = np.array(column, dtype=float)
            return
        texts, short = ([each(value) or "as in the scene" for value in column] for each in (text_of, short_text))
        texts = short if len({*short}) == len({*texts}) else texts
        self.names = [*dict.fromkeys(texts)]
        self.values = np.array([*map(self.names.index, texts)], dtype=float)

    def mark(self, axis: Any) -> None:
        """Write texts at an axis of Matplotlib."""
        if self.names:
            names = [name if len(name) < 19 else f"{name[:16]}..." for name in self.names]
            axis.set_ticks(range(len(names)), names)


def _lines(axes: Axes, keys: Sequence[_Axis], values: RealArray) -> None:
    """A metric over one key."""
    order = np.argsort(keys[0].values, kind="stable")
    axes.plot(keys[0].values[order], values[order], ".-")


def _map(axes: Axes, keys: Sequence[_Axis], values: RealArray) -> None:
    """A metric over two keys, as colours."""
    x, y = keys
    across, up = (np.unique(each.values) for each in keys)
    picture: Any
    if len(across) * len(up) == len(values):
        table = np.full((len(up), len(across)), np.nan)
        table[np.searchsorted(up, y.values), np.searchsorted(across, x.values)] = values
        picture = axes.pcolormesh(across, up, table, cmap=COLOURS, shading="nearest", rasterized=True)
    else:
        some = _some(values)
        picture = axes.scatter(x.values[some], y.values[some], c=values[some], cmap=COLOURS, s=9)
    axes.grid(False)
    axes.figure.colorbar(picture, ax=axes)
    axes.set_ylabel(y.label)
    y.mark(axes.yaxis)


def _some(values: RealArray) -> Any:
    """Cases that have a metric, at most `MOST_LINES` of them."""
    there = np.flatnonzero(~np.isnan(values))
    return there[:: ceil(len(there) / MOST_LINES)]


def _parallel(figure: Figure, keys: Sequence[_Axis], metrics: Sequence[tuple[str, RealArray]]) -> None:
    """A line for each case through the axes of all keys and some metrics."""
    some = _some(metrics[0][1])
    found = [(axis.label, axis.values[some], axis.names) for axis in keys]
    found += [(label, values[some], []) for label, values in metrics]
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.set_xlim(-0.3, len(found) - 0.5)
    axes.set_ylim(-0.12, 1.12)
    # every axis from its smallest to its largest value
    scaled = []
    for place, (label, values, names) in enumerate(found):
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        scaled.append((values - low) / (high - low) if high > low else np.full(len(values), 0.5))
        axes.plot([place, place], [0.0, 1.0], color="0.4", linewidth=1.0)
        axes.text(place, 1.06, label.replace(" [", "\n["), ha="center", fontsize=7)
        marks: Any = enumerate(names) if names else ((value, f"{value:.4g}") for value in np.linspace(low, high, 5))
        for value, text in marks:
            height = (value - low) / (high - low) if high > low else 0.5
            axes.text(place + 0.03, height, text[:18], fontsize=6.5, va="center")
    lines = np.stack([np.column_stack([np.arange(len(found)), each]) for each in np.array(scaled).T])
    colours = colormaps[COLOURS](scaled[len(keys)])
    axes.add_collection(LineCollection([*lines], colors=colours, linewidths=0.8, alpha=0.6))
    if len(some) < np.count_nonzero(~np.isnan(metrics[0][1])):
        axes.text(0.0, -0.1, f"{len(some)} of the cases are drawn", fontsize=7)

"""The picture of a sweep: lines over one key, heat maps over two, parallel coordinates over more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from numbers import Real
from typing import Any, Protocol

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.metric_table import ALL_METRICS
from flexfmu.cosim.reports.figure_style import draw, style
from flexfmu.cosim.studies.sweep.cases import Cases, Grid
from flexfmu.cosim.studies.sweep.store import text_of

MOST_LINES = 2000
"""Cases that parallel coordinates show; of more, equally many are left out between them."""

PANELS = 12
"""Metrics that have a panel of their own; of more, the first."""

AXES = 4
"""Metrics that have an axis in parallel coordinates; the first gives the colours."""

_PAPER = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.5}
"""Behind texts that lines cross."""

COLOURS = "viridis"
"""From small to large values, also for those who don't see all colours, and in print."""


class Swept(Protocol):
    """What is drawn of a sweep: the attributes of `flexfmu.cosim.studies.sweep.result.SweepResult`."""

    @property
    def name(self) -> str: ...
    @property
    def cases(self) -> Cases: ...
    @property
    def metrics(self) -> Sequence[str]: ...
    @property
    def values(self) -> RealArray: ...
    @property
    def messages(self) -> Mapping[int, str]: ...
    @property
    def units(self) -> Mapping[str, str]: ...

    def columns(self) -> list[list[Any]]: ...


def draw_sweep(result: Swept) -> Figure:
    """The metrics over the varied keys.

    One key: a panel with a line for each metric. Two: a heat map of each, or points where the cases are no grid. More: parallel
    coordinates with an axis for each key and the first metrics; colours are those of the first. Failed cases are left out.
    """
    with style():
        keys = [_Axis(key, result.units.get(key, ""), column) for key, column in _varied(result)]
        shown = [i for i in range(len(result.metrics)) if not np.isnan(result.values[:, i]).all()][:PANELS]
        if not shown or not keys:
            figure = draw(6.0, 2.0)
            figure.text(0.5, 0.5, "no case has a value to show" if not shown else "one case", ha="center", va="center")
        elif len(keys) > 2:
            figure = draw(max(7.0, 1.6 * (len(keys) + min(AXES, len(shown)))), 4.5)
            _parallel(figure, result, keys, shown[:AXES])
        else:
            columns = min(3, len(shown))
            rows = ceil(len(shown) / columns)
            figure = draw(0.5 + 3.6 * columns, 0.3 + 2.7 * rows)
            for place, i in enumerate(shown, start=1):
                axes = figure.add_subplot(rows, columns, place)
                (_lines if len(keys) == 1 else _map)(axes, result, keys, i)
        figure.suptitle(f"{result.name}: {len(result.cases)} cases" + _failures(result))
    return figure


def _varied(result: Swept) -> list[tuple[str, list[Any]]]:
    """The keys that have more than one value, with the value of each case."""
    columns = zip(result.cases.keys, result.columns(), strict=True)
    return [(key, column) for key, column in columns if len({repr(each) for each in column}) > 1]


def _failures(result: Swept) -> str:
    return f", {len(result.messages)} failed" if result.messages else ""


class _Axis:
    """The values of a key as numbers: themselves, or places in the list of its texts.

    Args:
        key: of the scene.
        unit: of its values.
        column: value of each case.

    Attributes:
        label: key and unit.
        values: (N,) positions.
        names: texts of the positions 0, 1, ...; None for numbers.
    """

    def __init__(self, key: str, unit: str, column: Sequence[Any]) -> None:
        self.label = f"{key} [{shown_unit(unit)}]" if unit else key
        self.names: list[str] | None = None
        if all(isinstance(each, Real) and not isinstance(each, bool) for each in column):
            self.values: RealArray = np.array(column, dtype=float)
            return
        texts = [text_of(each) or "as in the scene" for each in column]
        # a table by its kind, where that tells it from the others
        kinds = {
            text: each["kind"]
            for text, each in zip(texts, column, strict=True)
            if isinstance(each, Mapping) and "kind" in each
        }
        if len({kinds.get(text, text) for text in texts}) == len(set(texts)):
            texts = [kinds.get(text, text) for text in texts]
        self.names = [*dict.fromkeys(texts)]
        places = {name: i for i, name in enumerate(self.names)}
        self.values = np.array([places[each] for each in texts], dtype=float)

    def mark(self, axis: Any) -> None:
        """Write texts at an axis of Matplotlib."""
        if self.names is not None:
            axis.set_ticks(
                range(len(self.names)), [name if len(name) < 19 else f"{name[:16]}..." for name in self.names]
            )


def _title(result: Swept, i: int) -> str:
    """Label of a metric with its unit."""
    name = result.metrics[i]
    label = ALL_METRICS[name].label if name in ALL_METRICS else name
    unit = shown_unit(result.units.get(name, ""))
    return f"{label} [{unit}]" if unit else label


def _lines(axes: Axes, result: Swept, keys: Sequence[_Axis], i: int) -> None:
    """A metric over one key."""
    order = np.argsort(keys[0].values, kind="stable")
    axes.plot(
        keys[0].values[order], result.values[order, i], marker="o" if len(result.cases) <= 60 else "", markersize=3
    )
    axes.set_title(_title(result, i), fontsize=8.5)
    axes.set_xlabel(keys[0].label)
    keys[0].mark(axes.xaxis)


def _map(axes: Axes, result: Swept, keys: Sequence[_Axis], i: int) -> None:
    """A metric over two keys, as colours."""
    x, y = keys
    shape = [np.unique(each.values) for each in keys]
    if isinstance(result.cases, Grid) and len(shape[0]) * len(shape[1]) == len(result.cases):
        table = np.full((len(shape[1]), len(shape[0])), np.nan)
        table[np.searchsorted(shape[1], y.values), np.searchsorted(shape[0], x.values)] = result.values[:, i]
        picture: Any = axes.pcolormesh(shape[0], shape[1], table, cmap=COLOURS, shading="nearest", rasterized=True)
    else:
        some = _some(result, i)
        picture = axes.scatter(x.values[some], y.values[some], c=result.values[some, i], cmap=COLOURS, s=9)
    axes.grid(False)
    axes.figure.colorbar(picture, ax=axes)
    axes.set_title(_title(result, i), fontsize=8.5)
    axes.set_xlabel(x.label)
    axes.set_ylabel(y.label)
    x.mark(axes.xaxis)
    y.mark(axes.yaxis)


def _some(result: Swept, i: int) -> Any:
    """Cases that have a metric, at most `MOST_LINES` of them."""
    there = np.flatnonzero(~np.isnan(result.values[:, i]))
    return there[:: ceil(len(there) / MOST_LINES)]


def _parallel(figure: Figure, result: Swept, keys: Sequence[_Axis], metrics: Sequence[int]) -> None:
    """A line for each case through the axes of all keys and some metrics."""
    some = _some(result, metrics[0])
    found = [(axis.label, axis.values[some], axis.names) for axis in keys]
    found += [(_title(result, i), result.values[some, i], None) for i in metrics]
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
        marks = (
            [(each, name) for each, name in enumerate(names)]
            if names
            else [(v, f"{v:.4g}") for v in np.linspace(low, high, 5)]
        )
        for value, text in marks:
            height = (value - low) / (high - low) if high > low else 0.5
            axes.text(place + 0.03, height, text[:18], fontsize=6.5, va="center", bbox=_PAPER)
    lines = np.stack([np.column_stack([np.arange(len(found)), each]) for each in np.array(scaled).T])
    colours = colormaps[COLOURS](scaled[len(keys)])
    axes.add_collection(LineCollection([*lines], colors=colours, linewidths=0.8, alpha=0.6))
    if len(some) < len(result.cases) - len(result.messages):
        axes.text(0.0, -0.1, f"{len(some)} of the cases are drawn", fontsize=7)

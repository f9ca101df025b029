"""Signals as a Matplotlib figure: a pair of axes for each unit, and another one for what would be flat there."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from flexfmu.cosim.engine.columns import Column
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.engine.slave import RealArray

FLAT = 0.01
"""Range of a signal relative to the largest of its unit below which it would be a straight line."""

SMALLER, SMALL = {"m": "mm", "rad": "mrad"}, 0.1
"""Unit of signals → that of their thousandths, in which those are shown whose values all are below this."""


class NotebookFigure(Figure):
    """A figure that belongs to no window; notebooks show it once, scripts save it by `savefig`."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, format="png", dpi=100)
        return content.getvalue()


def draw_signals(time: RealArray, columns: Mapping[str, Column], title: str = "") -> NotebookFigure:
    """Return a figure of signals over time, those of a unit and of similar size in one pair of axes; a jump is a vertical line.

    Args:
        time: (N,) instants [s].
        columns: name → signal, of numbers.
        title: heading; empty for none.
    """
    # unit, and whether it is flat beside others → names
    finite = {name: column.values[np.isfinite(column.values)] for name, column in columns.items()}
    spans = {name: float(np.ptp(values)) if values.size else 0.0 for name, values in finite.items()}
    groups: dict[tuple[str, bool], list[str]] = {}
    for name, column in columns.items():
        largest = max(span for other, span in spans.items() if columns[other].unit == column.unit)
        groups.setdefault((column.unit, 0.0 < spans[name] < FLAT * largest), []).append(name)
    figure = NotebookFigure(figsize=(8.0, 1.0 + 2.0 * max(len(groups), 1)), layout="constrained")
    figure.suptitle(title)
    all_axes = figure.subplots(max(len(groups), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axes, ((unit, _), names) in zip(all_axes, groups.items(), strict=False):
        # dashes where colours repeat
        axes.set_prop_cycle(cycler(linestyle=["-", "--", ":", "-."]) * matplotlib.rcParams["axes.prop_cycle"])
        is_small = unit in SMALLER and all(np.abs(finite[name]).max(initial=0.0) < SMALL for name in names)
        for name in names:
            axes.plot(time, (1e3 if is_small else 1.0) * columns[name].values, label=name, linewidth=1.2)
        shown = SMALLER[unit] if is_small else shown_unit(unit)
        axes.set_ylabel(f"[{shown}]" if unit else "value")
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    all_axes[-1].set_xlabel("time [s]")
    return figure

"""Signals as a Matplotlib figure: a pair of axes for each unit, and another one for what would be flat there."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

import numpy as np
from matplotlib.figure import Figure

from flexfmu.cosim.engine.columns import Column
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.engine.slave import RealArray

FLAT = 0.01
"""Range of a signal relative to the largest of its unit below which it would be a straight line."""


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
        for name in names:
            axes.plot(time, columns[name].values, label=name, linewidth=1.2)
        axes.set_ylabel(f"[{shown_unit(unit)}]" if unit else "value")
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    all_axes[-1].set_xlabel("time [s]")
    return figure

"""Signals as a Matplotlib figure: a pair of axes for each unit."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO

from matplotlib.figure import Figure

from flexfmu.cosim.engine.columns import Column
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.engine.slave import RealArray


class NotebookFigure(Figure):
    """A figure that belongs to no window; notebooks show it once, scripts save it by `savefig`."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, format="png", dpi=100)
        return content.getvalue()


def draw_signals(time: RealArray, columns: Mapping[str, Column], title: str = "") -> NotebookFigure:
    """Return a figure of signals over time, those of a unit in one pair of axes; a jump is a vertical line.

    Args:
        time: (N,) instants [s].
        columns: name → signal, of numbers.
        title: heading; empty for none.
    """
    units = list(dict.fromkeys(column.unit for column in columns.values()))
    figure = NotebookFigure(figsize=(8.0, 1.0 + 2.0 * max(len(units), 1)), layout="constrained")
    figure.suptitle(title)
    all_axes = figure.subplots(max(len(units), 1), 1, sharex=True, squeeze=False)[:, 0]
    for axes, unit in zip(all_axes, units, strict=False):
        for name, column in columns.items():
            if column.unit == unit:
                axes.plot(time, column.values, label=name, linewidth=1.2)
        axes.set_ylabel(f"[{shown_unit(unit)}]" if unit else "value")
        axes.grid(True, alpha=0.3)
        axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    all_axes[-1].set_xlabel("time [s]")
    return figure

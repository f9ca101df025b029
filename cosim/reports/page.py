"""Pages of results: one HTML file each, with one style and one script, that fetches nothing and can be read without scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from flexfmu.cosim.reports.chart import MOST_POINTS, Panel, draw_chart

WIDTH, HEIGHT = 374.4, 194.4
"""Usual size of plots [pt]."""


@dataclass(frozen=True)
class Plot:
    """A chart of a page.

    Attributes:
        key: short identifier, unique within the page.
        title, caption: heading, and one sentence on the plot.
        panels: pairs of axes below each other.
        x_label: label of the horizontal axis.
        height: of the plot [pt].
        points: largest number of points of a curve.
    """

    key: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    x_label: str = "time [s]"
    height: float = HEIGHT
    points: int = MOST_POINTS

    @property
    def html(self) -> str:
        """The plot as an element of a page."""
        return draw_chart(self.key, self.title, (WIDTH, self.height), self.x_label, self.panels, self.points)


@dataclass(frozen=True)
class Table:
    """A table of a page: texts, the first column left-aligned, the others as numbers.

    Attributes:
        title, note: heading, and a sentence below the table.
        header: names of the columns.
        rows: cells.
        texts: number of last columns that are sentences; on a phone each row is then a block.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    texts: int = 0


def render_page(
    title: str,
    lead: str,
    plots: Sequence[Plot] = (),
    tables: Sequence[Table] = (),
    tiles: Sequence[tuple[str, str]] = (),
) -> str:
    """Return a page of plots and tables as HTML.

    Args:
        title: heading of the page.
        lead: what it shows, in one or two sentences.
        plots: figures in their order.
        tables: tables in their order, before the figures.
        tiles: the main figures, each with what it is.
    """
    return render("results.html.j2", title=title, lead=lead, plots=plots, tables=tables, tiles=tiles)


def render(template: str, **values: Any) -> str:
    """Return a page by one of the templates, all values as text."""
    library = f"/* {_text('LICENSE', 'uplot')} */\n{_text('uPlot.iife.min.js', 'uplot')}"
    parts: Mapping[str, str] = {
        "style": _text("uPlot.min.css", "uplot") + _text("page.css"),
        "script": library + _text("page.js"),
        "simulation": _text("simulation.js"),
        "live_script": _text("live.js"),
    }
    return _environment().get_template(template).render(**parts, **values)


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("flexfmu.cosim.reports", "templates"), autoescape=True, undefined=StrictUndefined
    )


@cache
def _text(name: str, folder: str = "templates") -> str:
    return files("flexfmu.cosim.reports").joinpath(folder, name).read_text(encoding="utf-8")

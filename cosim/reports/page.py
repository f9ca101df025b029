"""Pages of results: one HTML file each, with one style and one script, that fetches nothing and can be read without scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from flexfmu.cosim.reports.chart import Panel, draw_chart

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
    """

    key: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    x_label: str = "time [s]"
    height: float = HEIGHT

    @property
    def svg(self) -> str:
        """The plot as an SVG element."""
        return draw_chart(self.key, self.title, (WIDTH, self.height), self.x_label, self.panels)


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


def render_page(title: str, lead: str, plots: Sequence[Plot] = (), tables: Sequence[Table] = ()) -> str:
    """Return a page of plots and tables as HTML.

    Args:
        title: heading of the page.
        lead: what it shows, in one or two sentences.
        plots: figures in their order.
        tables: tables in their order, before the figures.
    """
    return render("results.html.j2", title=title, lead=lead, plots=plots, tables=tables)


def render(template: str, **values: Any) -> str:
    """Return a page by one of the templates, all values as text."""
    parts: Mapping[str, str] = {"style": _text("page.css"), "script": _text("page.js")}
    return _environment().get_template(template).render(**parts, **values)


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("flexfmu.cosim.reports", "templates"), autoescape=True, undefined=StrictUndefined
    )


@cache
def _text(name: str) -> str:
    return files("flexfmu.cosim.reports").joinpath("templates", name).read_text(encoding="utf-8")

"""Pages of results: a verdict, a few figures, plots, tables; one HTML file each, which fetches nothing and can be read without scripts.

All commands' pages have one frame, `Page`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any, Self

from jinja2 import Environment, PackageLoader, StrictUndefined

from flexfmu.cosim.metrics.metric_table import definition, display
from flexfmu.cosim.reports.chart import MOST_POINTS, Panel, draw_chart

WIDTH, HEIGHT = 374.4, 194.4
"""Usual size of plots [pt]."""


class Figure(str):
    """A metric's value as text, which a page that simulates computes anew.

    Attributes:
        name: of the metric.
        data: what the page's script needs, as JSON.
        is_over: whether the value is beyond its limit.
    """

    name: str
    data: str
    is_over: bool

    @classmethod
    def of(
        cls, name: str, value: float | None, *, run: int = 0, text: str = "", limit: float | None = None,
        error: float | None = None, digits: int | None = None, is_compared: bool = False,
    ) -> Self:  # fmt: skip
        """A metric of one of the page's runs.

        Args:
            name: of the metric.
            value: in SI units; None for none.
            run: place of the run among those of the page.
            text: what is shown; empty for the value with as many digits as its ``error`` allows, or so many.
            limit: largest value that is wanted; None for none.
            error, digits: as for `display`.
            is_compared: whether the text has the difference from the first run's value.
        """
        info = definition(name)
        found = cls(
            text or (display(name, value, error=error) if digits is None else display(name, value, digits, error))
        )
        found.name, found.is_over = name, limit is not None and value is not None and value > limit
        facts = {
            "run": run,
            "factor": info.displayed(1.0),
            "unit": info.display_unit,
            "limit": limit,
            "compared": is_compared,
        }
        found.data = json.dumps(facts)
        return found


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
        header: names of the columns; none for a table without.
        rows: cells.
        texts: number of last columns that are sentences; on a phone each row is then a block.
        is_open: whether the table isn't folded away, where tables are.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    texts: int = 0
    is_open: bool = False


@dataclass(frozen=True)
class Live:
    """Runs that a page simulates.

    Attributes:
        packed: the runs as modules, by `flexfmu.cosim.exchange.live.packed`; empty for a page that doesn't simulate.
        reasons: why some of them stay as recorded.
    """

    packed: str = ""
    reasons: Sequence[str] = ()


RECORDED = Live()
"""A page that doesn't simulate."""


@dataclass(frozen=True)
class Page:
    """A page of results.

    Attributes:
        title: heading.
        verdict: what was found, in one or two sentences.
        plots, tables: in their order, the tables before the plots.
        tiles: the main figures: what each is, and its values.
        lead: what the page is about.
        notices: what the reader must know first: sentence and details.
        has_failed: whether the first notice is of a failure.
        first, first_title: plots on top, beside the sliders of a page that simulates, and their heading.
        answers: heading, sentences and plots of what was asked for.
        folded: tables behind the plots, which a click opens.
        live: what the page simulates.
    """

    title: str
    verdict: str
    plots: Sequence[Plot] = ()
    tables: Sequence[Table] = ()
    tiles: Sequence[tuple[str, Sequence[str]]] = ()
    lead: str = ""
    notices: Sequence[tuple[str, str]] = ()
    has_failed: bool = False
    first: Sequence[Plot] = ()
    first_title: str = "The robot in motion"
    answers: tuple[str, Sequence[str], Sequence[Plot]] = ("", (), ())
    folded: Sequence[Table] = ()
    live: Live = RECORDED

    @property
    def html(self) -> str:
        """The page."""
        return render("page.html.j2", page=self)


FEW_POINTS = 300
"""Points of a curve in a page that simulates, which draws its curves from its own runs."""


def with_few_points(page: Page) -> Page:
    """The page with curves of `FEW_POINTS`."""
    first, plots = ([replace(each, points=FEW_POINTS) for each in some] for some in (page.first, page.plots))
    return replace(page, first=first, plots=plots)


def render(template: str, **values: Any) -> str:
    """Return a page by one of the templates, all values as text."""
    library = f"/* {_text('LICENSE', 'uplot')} */\n{_text('uPlot.iife.min.js', 'uplot')}"
    parts: Mapping[str, str] = {
        "style": _text("uPlot.min.css", "uplot") + _text("page.css"),
        "script": library + _text("page.js"),
        "simulation": _text("simulation.js") + _text("live.js"),
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

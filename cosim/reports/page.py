"""Pages of results: a verdict, a few figures, plots, tables; one HTML file each, which fetches nothing and can be read without scripts.

All commands' pages have one frame, `Page`.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from html import escape
from importlib.resources import files
from typing import Any, Literal, Self

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from flexfmu.cosim.metrics.metric_table import OF_BOTH, definition, display, without_noise
from flexfmu.cosim.reports.chart import MOST_POINTS, Panel

HEIGHT = 194.4
"""Usual height of plots [pt]."""

PIXELS, LEAST_HEIGHT = 1.25, 110
"""Pixels of a point, and least height of a panel [px]."""

POINTS, FEWEST, LIVE_POINTS = 60_000, 40, 300
"""Number of points that a page's curves have together, and of one curve at least: they limit the size of the page. A curve of a page that
simulates has fewer, for the page draws the curves of its own runs."""

FIRST_METRICS = (
    "peak_torque",
    "peak_tip_deflection",
    "peak_position_error",
    "rms_acceleration_error",
    "residual_vibration_amplitude",
    "settling_time",
)
"""Metrics shown at the top of pages, of both joints or legs the larger one."""

TILES = 6
"""Largest number of figures there."""

PLAIN = "–", "{}", "{}"
"""How a figure is said without a value, within its limit, and otherwise."""


class Figure(str):
    """A metric's value in words, which a page that simulates says anew.

    Attributes:
        name: of the metric; one that the page's script doesn't compute stays as recorded.
        data: what the script needs, as JSON.
        is_over: whether the value is beyond its limit.
    """

    name: str
    data: str
    is_over: bool

    @classmethod
    def of(
        cls,
        name: str,
        value: float | None,
        *,
        run: int = 0,
        error: float | None = None,
        digits: int | None = None,
        limit: float | None = None,
        phrases: tuple[str, str, str] = PLAIN,
        base: float | None = None,
        is_relative: bool = False,
    ) -> Self:
        """A metric of one of the page's runs, with as many digits as its error allows.

        Args:
            name: of the metric, or of `OF_BOTH`.
            value: in SI units; None for none.
            run: place of the run among those of the page.
            error, digits: as for `display`.
            limit: largest value that is wanted; None for none.
            phrases: as `PLAIN`; the text stands in place of the braces.
            base: value of the first run, from which the difference is said, too.
            is_relative: whether the value is said relative to its limit.
        """
        value, base = (without_noise(name, each) for each in (value, base))
        # numbers as the script has them
        text = re.sub(r"(?<=\d)e\+?(-?)0*", r"e\1", display(name, value, digits, error)).replace("-", "−")
        info = definition(name)
        factor, unit = info.displayed(1.0), info.display_unit
        is_over = value is not None and limit is not None and value > limit
        if is_relative and value is not None and limit:
            text, factor, unit = f"{value / limit:.3g}", 1.0 / limit, ""
        if base and value is not None:
            # without a power of ten
            text += f" ({float(f'{100.0 * (value - base) / abs(base):.3g}'):+g} %)".replace("-", "−")
        within = value is not None and value <= (limit or 0.0)
        phrase = phrases[0 if value is None else 1 if within else 2]
        facts: dict[str, Any] = {"parts": OF_BOTH.get(name, [name]), "factor": factor, "unit": unit, "limit": limit}
        facts |= {"digits": digits or 5, "compared": base, "phrases": phrases}
        facts |= {"label": info.label, "negligible": info.negligible}
        return cls.said(phrase.replace("{}", text), name, is_over=is_over, run=run, **facts)

    @classmethod
    def said(cls, text: str, name: str = "", *, is_over: bool = False, **facts: Any) -> Self:
        """A text that depends on the run, with what the script needs to say it anew."""
        found = cls(text)
        found.name, found.is_over, found.data = name, is_over, json.dumps({"run": 0} | facts)
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
    """

    key: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    x_label: str = "time [s]"
    height: float = HEIGHT

    def html(self, points: int) -> str:
        """The plot as an element of a page, with at most so many points of a curve: what its script draws, as JSON."""
        height = round(max(LEAST_HEIGHT, PIXELS * self.height / len(self.panels)))
        panels = [each.thinned(points) for each in self.panels]
        data = {"key": self.key, "x": self.x_label, "height": height, "panels": panels}
        text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), default=as_data).replace("<", "\\u003c")
        plain = "".join(each.plain(self.x_label) for each in self.panels)
        return (
            f'<div class="chart" role="group" aria-label="{escape(self.title)}"><script type="application/json">{text}</script>'
            f"<noscript>{plain}</noscript></div>"
        )


def as_data(each: Any) -> Any:
    """What JSON has of panels, curves and markers; arrays are base64 of little-endian 32-bit numbers, whose 24 significant bits are enough
    for zooming and reading."""
    return base64.b64encode(each.astype("<f4").tobytes()).decode() if isinstance(each, np.ndarray) else vars(each)


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
        reasons: what it does otherwise, some of them can't be simulated for example.
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
        verdict: what was found, in one or two sentences; parts, among them figures.
        plots, tables: in their order, the tables before the plots.
        tiles: the main figures: what each is, and its values.
        lead: what the page is about.
        notices: what the reader must know first: kind, sentence and details.
        first: plots of the robot in motion, on top, beside the sliders of a page that simulates.
        answers: sentences and plots on the accuracy that was asked for.
        folded: tables behind the plots, which a click opens.
        live: what the page simulates.
    """

    title: str
    verdict: Sequence[str]
    plots: Sequence[Plot] = ()
    tables: Sequence[Table] = ()
    tiles: Sequence[tuple[str, Sequence[str]]] = ()
    lead: str = ""
    notices: Sequence[tuple[Literal["failed", "warned"], str, str]] = ()
    first: Sequence[Plot] = ()
    answers: tuple[Sequence[str], Sequence[Plot]] = ((), ())
    folded: Sequence[Table] = ()
    live: Live = RECORDED

    @property
    def points(self) -> int:
        """Largest number of points of a curve."""
        plots = *self.first, *self.answers[1], *self.plots
        curves = sum(len(panel.curves) for plot in plots for panel in plot.panels)
        return LIVE_POINTS if self.live.packed else min(max(POINTS // max(curves, 1), FEWEST), MOST_POINTS)

    @cached_property
    def html(self) -> str:
        """The page."""
        return render("page.html.j2", page=self)


def render(template: str, **values: Any) -> str:
    """Return a page by one of the templates, all values as text."""
    library = f"/* {_text('LICENSE', 'uplot')} */\n{_text('uPlot.iife.min.js', 'uplot')}"
    parts: Mapping[str, str] = {
        "style": _text("uPlot.min.css", "uplot") + _text("page.css"),
        "script": library + _text("page.js"),
        "simulation": _text("fmu.js", package="flexfmu.fmu_build").replace("export ", "")
        + _text("simulation.js")
        + _text("live.js"),
    }
    return _environment().get_template(template).render(**parts, **values)


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("flexfmu.cosim.reports", "templates"), autoescape=True, undefined=StrictUndefined
    )


@cache
def _text(name: str, folder: str = "templates", package: str = "flexfmu.cosim.reports") -> str:
    return files(package).joinpath(folder, name).read_text(encoding="utf-8")

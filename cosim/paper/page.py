"""The report as one HTML file that needs no network: tables, and figures embedded."""

from __future__ import annotations

import base64
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from flexfmu.cosim.paper.layout import lay_out
from flexfmu.cosim.paper.report import Figure, PaperReport


def report_to_html(report: PaperReport, folder: Path) -> str:
    """Render the report.

    Args:
        report: what has been computed.
        folder: where its figures have been written.
    """
    template = files("flexfmu.cosim.paper").joinpath("data", "report.html.j2").read_text(encoding="utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.from_string(template).render(
        source=report.source,
        summary=report.summary(),
        pages=[lay_out(table) for table in report.tables],
        figures=[_embedded(figure, folder) for figure in report.figures],
        overview=_embedded(report.overview, folder) if report.overview else None,
        timing=report.timing,
        versions=report.versions,
    )


def _embedded(figure: Figure, folder: Path) -> dict[str, Any]:
    """The figure with its SVG file as a data URL: identifiers of different figures can't clash."""
    data = base64.b64encode((folder / figure.file(".svg")).read_bytes()).decode("ascii")
    return {
        "key": figure.key,
        "label": figure.label,
        "caption": figure.caption,
        "image": f"data:image/svg+xml;base64,{data}",
    }

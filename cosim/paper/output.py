"""Files of the report, each written whole: a reader, or an interruption, never leaves half a file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from flexfmu.cosim.metric_table import METRICS
from flexfmu.cosim.paper.errors import PaperError
from flexfmu.cosim.paper.page import report_to_html
from flexfmu.cosim.paper.report import PaperReport
from flexfmu.cosim.paper.simulations import Simulation
from flexfmu.cosim.paper.spreadsheet import table_to_csv


def write_report(report: PaperReport, folder: Path) -> None:
    """Write what is known of the report: page, Markdown, JSON, and every table as CSV.

    Raises:
        PaperError: the folder can't be written.
    """
    for table in report.tables:
        write_text(folder / "tables" / f"{table.printed.key}.csv", table_to_csv(table))
    write_text(folder / "paper.md", report.to_markdown())
    write_text(folder / "paper.json", report.to_json())
    write_text(folder / "report.html", report_to_html(report, folder))


def write_simulations(simulations: Iterable[Simulation], folder: Path) -> None:
    """Write all metrics of the simulations (SI units) to ``simulations.csv``, one line each.

    Raises:
        PaperError: the folder can't be written.
    """
    lines = [",".join(("scene", "profile", "curve", *METRICS, "simulation_time"))]
    for simulation in simulations:
        values = [*(simulation.metrics[name] for name in METRICS), simulation.simulation_time]
        figures = ("" if value is None else f"{value:.9g}" for value in values)
        lines.append(",".join((*simulation.case, *figures)))
    write_text(folder / "simulations.csv", "\n".join(lines) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file under another name, then rename it.

    Raises:
        PaperError: the file can't be written, with the system's reason and the remedy.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise unwritable(path, error) from error


def unwritable(path: Path, error: OSError) -> PaperError:
    """The error for a file or folder that can't be written."""
    return PaperError(f"can't write {path}: {error.strerror or error}; choose another folder with --out")

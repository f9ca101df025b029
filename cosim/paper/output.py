"""Files of the report, each written whole: a reader, or an interruption, never leaves half a file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from flexfmu.cosim.measuring.metric_table import METRICS
from flexfmu.cosim.paper.page import report_to_html
from flexfmu.cosim.paper.report import PaperReport
from flexfmu.cosim.paper.simulations import Simulation
from flexfmu.cosim.paper.spreadsheet import table_to_csv
from flexfmu.cosim.reports.output import OutputFolder


def write_report(report: PaperReport, folder: Path) -> None:
    """Write what is known of the report: page, Markdown, JSON, and every table as CSV.

    Raises:
        ResultsError: the folder can't be written.
    """
    for table in report.tables:
        OutputFolder(folder / "tables").write(f"{table.printed.key}.csv", table_to_csv(table))
    OutputFolder(folder).write("paper.md", report.to_markdown())
    OutputFolder(folder).write("paper.json", report.to_json())
    OutputFolder(folder).write("report.html", report_to_html(report, folder))


def write_simulations(simulations: Iterable[Simulation], folder: Path) -> None:
    """Write all metrics of the simulations (SI units) to ``simulations.csv``, one line each.

    Raises:
        ResultsError: the folder can't be written.
    """
    lines = [",".join(("scene", "profile", "curve", *METRICS, "simulation_time"))]
    for simulation in simulations:
        values = [*(simulation.metrics[name] for name in METRICS), simulation.simulation_time]
        figures = ("" if value is None else f"{value:.9g}" for value in values)
        lines.append(",".join((*simulation.case, *figures)))
    OutputFolder(folder).write("simulations.csv", "\n".join(lines) + "\n")

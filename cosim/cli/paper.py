"""`flexfmu paper`: the paper's tables beside the computed ones."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from flexfmu.cosim.cli.console import print_text, progress, rich_output
from flexfmu.cosim.cli.options import JsonOption, option


def paper(
    out: Annotated[Path | None, option("DIR", "Folder of the results. Default: results/paper.")] = None,
    json: JsonOption = False,
) -> int:
    """Repeat the paper's experiment: every table beside the printed one, and the figures.

    Barnard, Briot and Caro, "Trajectory Generation for High Speed Pick-and-Place Robots", ESDA 2012.
    """
    from flexfmu.cosim.studies.paper.command import DEFAULT_FOLDER, run_paper
    from flexfmu.cosim.studies.paper.report import print_report

    folder = out or DEFAULT_FOLDER
    with progress() as show:
        report = run_paper(folder, progress=show)
    # standard output
    if json:
        print_text(report.to_json())
        return 0
    with rich_output() as console:
        print_report(report, console)
    print_text(f"Report, tables and figures are in {folder}\n")
    return 0

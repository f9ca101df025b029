"""`flexfmu paper`: the paper's tables beside the computed ones."""

from __future__ import annotations

from pathlib import Path

from flexfmu.cosim.cli.console import print_text, progress, rich_output


def paper_command(out: Path | None, as_json: bool) -> int:
    """Run the paper's experiment and print its report; the exit status."""
    from flexfmu.cosim.studies.paper.command import DEFAULT_FOLDER, run_paper
    from flexfmu.cosim.studies.paper.report import print_report

    folder = out or DEFAULT_FOLDER
    with progress() as show:
        report = run_paper(folder, progress=show)
    if as_json:
        print_text(report.to_json())
        return 0
    with rich_output() as console:
        print_report(report, console)
    print_text(f"Report, tables and figures are in {folder}\n")
    return 0

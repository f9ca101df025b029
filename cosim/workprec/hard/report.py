"""The suite's results as text: a table for the terminal, Markdown, and plain data."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.reports.versions import versions
from flexfmu.cosim.workprec.hard.case import Check, Finding
from flexfmu.cosim.workprec.hard.suite import Result

COLUMNS = ("case", "what makes it hard", "what happened", "verdict")

INTRODUCTION = """# Hard cases

Made by `flexfmu workprec --hard`, which runs every case and ends with status 1 if one of them fails.

Errors are the largest distance of the end effector from what SciPy's DOP853, Radau or LSODA, tight enough not to show, make of the
same equations (neither our integrator nor our master), relative to what elasticity does in that case; ten times the tolerance of
1e-7 that the FMUs get is allowed. The closure residual is recomputed from joint angles, deflections and end effector. "Off the branch" are instants at which the
end effector isn't on the side of the elbows where it started. Each figure stands with the limit it was held to."""


def terminal_table(results: Sequence[Result]) -> Table:
    """One line for each case."""
    table = Table(box=box.SIMPLE_HEAD, title="Hard cases", title_justify="left", title_style="bold", expand=True)
    for column, ratio in zip(COLUMNS, (3, 4, 8, 1), strict=True):
        table.add_column(column, ratio=ratio, min_width=7, overflow="fold")
    for result in results:
        table.add_row(*(Text(cell) for cell in row(result)))
    return table


def row(result: Result) -> tuple[str, ...]:
    """Cells of a case."""
    happened = f"{result.finding.happened}. {figures(result.finding)}"
    return result.case.name, result.case.hard, happened, "passed" if result.finding.passed else "FAILED"


def figures(finding: Finding) -> str:
    """What was measured; what must be zero and is, in one go."""
    zero = [check.name for check in finding.checks if check.value == 0.0]
    others = [_figure(check) for check in finding.checks if check.value != 0.0]
    return "; ".join([*others, *([f"none or zero: {', '.join(zero)}"] if zero else [])])


def _figure(check: Check) -> str:
    unit = f" {check.unit}" if check.unit else ""
    return f"{check.name} {check.value:.2g}{unit} ({'<=' if check.passed else 'NOT <='} {check.limit:.2g})"


def conclusion(results: Sequence[Result]) -> str:
    """One sentence."""
    failed = [result.case.name for result in results if not result.finding.passed]
    if failed:
        return f"{len(failed)} of {len(results)} hard cases failed: {', '.join(failed)}."
    return f"All {len(results)} hard cases passed."


def markdown(results: Sequence[Result]) -> str:
    """Introduction, table and conclusion."""
    cells = [COLUMNS, (":--",) * len(COLUMNS), *(map(_escaped, row(result)) for result in results)]
    table = "\n".join("| " + " | ".join(each) + " |" for each in cells)
    return "\n\n".join([INTRODUCTION, table, conclusion(results)]) + "\n"


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|").replace("*", "\\*")


def data(results: Sequence[Result]) -> dict[str, Any]:
    """Everything for machines; a value that is no finite number is null."""
    return {
        "passed": all(result.finding.passed for result in results),
        "cases": [
            {
                "name": result.case.name,
                "hard": result.case.hard,
                "happened": result.finding.happened,
                "passed": result.finding.passed,
                "checks": [_check_data(check) for check in result.finding.checks],
            }
            for result in results
        ],
        "versions": versions(),
    }


def _check_data(check: Check) -> dict[str, Any]:
    value = check.value if isfinite(check.value) else None
    return {"name": check.name, "value": value, "limit": check.limit, "unit": check.unit, "passed": check.passed}

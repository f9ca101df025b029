"""The suite of hard cases: their list, how they are run, and their results as a table for the terminal, Markdown, and plain data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from math import isfinite
from typing import Any

from rich.table import Table as TerminalTable
from rich.text import Text

from flexfmu.benchmarks.hard_cases import repetition, singularity, steps
from flexfmu.benchmarks.hard_cases.case import CaseReport, HardCase
from flexfmu.benchmarks.hard_cases.extremes import motion_cases, parameter_cases, stated_cases, stiffness_cases
from flexfmu.benchmarks.hard_cases.steps import gain_cases, step_cases
from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.reports.page import Page, Table
from flexfmu.cosim.reports.summary import versions
from flexfmu.cosim.reports.terminal import markdown_table, titled_table
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.trajectories.errors import TrajectoryError

FAMILIES: tuple[Callable[[], Iterable[HardCase]], ...] = (
    singularity.cases,
    stiffness_cases,
    parameter_cases,
    motion_cases,
    step_cases,
    steps.sticking_cases,
    gain_cases,
    repetition.cases,
    stated_cases,
)
"""Functions that make the cases, in the order of the table."""


@dataclass(frozen=True)
class HardCaseResult:
    """A case with its report.

    Attributes:
        case: the case.
        report: its criteria.
    """

    case: HardCase
    report: CaseReport


def hard_cases(only: Sequence[str] = ()) -> tuple[HardCase, ...]:
    """The cases in the order of the table.

    Args:
        only: parts of the names of those that are wanted; all when empty.

    Raises:
        InputError: no case has such a name.
    """
    cases = tuple(chain.from_iterable(family() for family in FAMILIES))
    for part in only:
        if not any(_has(case, part) for case in cases):
            raise InputError(
                f"no hard case has {part!r} in its name; there are: {'; '.join(case.name for case in cases)}"
            )
    return tuple(case for case in cases if not only or any(_has(case, part) for part in only))


def run_cases(cases: Iterable[HardCase], announce: Callable[[str], object]) -> list[HardCaseResult]:
    """Run the cases one after the other; a case that can't be run has failed.

    Args:
        cases: the cases.
        announce: called with the name of each case.

    Raises:
        BuildError: an FMU can't be built.
    """
    results = []
    for case in cases:
        announce(case.name)
        try:
            report = case.run()
        except (CosimError, EquilibriumError, TrajectoryError) as failure:
            report = CaseReport(f"{type(failure).__name__}: {failure}", ())
        results.append(HardCaseResult(case, report))
    return results


def _has(case: HardCase, part: str) -> bool:
    return part.casefold() in case.name.casefold()


COLUMNS = ("case", "what makes it hard", "what happened", "verdict")

INTRODUCTION = """# Hard cases

Made by `flexfmu workprec --hard`, which runs every case and ends with status 1 if one of them fails.

Errors are the largest distance of the end effector from a reference: the same equations solved by SciPy's DOP853, Radau or LSODA
with negligible error (neither our integrator nor our master), relative to the largest elastic deviation of that case; ten times the
FMUs' tolerance of 1e-7 is allowed. The closure residual is recomputed from joint angles, deflections and end effector. "Off the
branch" are instants at which the end effector isn't on the side of the elbows where it started. Each value stands with its limit.
"Error over stated error" is the largest of all metrics of a run as users make it, against runs at a tolerance of 1e-12 with steps of
0.1 ms, of which those are compared that two such runs tell well enough. What can't be run says so in a sentence."""


def terminal_table(results: Sequence[HardCaseResult]) -> TerminalTable:
    """One line for each case."""
    table = titled_table("Hard cases", *COLUMNS)
    for result in results:
        table.add_row(*(Text(cell) for cell in row(result)))
    return table


def row(result: HardCaseResult) -> tuple[str, ...]:
    """Cells of a case."""
    happened = f"{result.report.happened}. {figures(result.report)}"
    return result.case.name, result.case.hard, happened, "passed" if result.report.passed else "FAILED"


def figures(report: CaseReport) -> str:
    """The measured values; zeros in one list."""
    zero = [check.name for check in report.checks if check.value == 0.0]
    others = []
    for check in report.checks:
        unit = f" {check.unit}" if check.unit else ""
        relation = "<=" if check.passed else "NOT <="
        if check.value != 0.0:
            others.append(f"{check.name} {check.value:.2g}{unit} ({relation} {check.limit:.2g})")
    return "; ".join([*others, *([f"zero: {', '.join(zero)}"] if zero else [])])


def conclusion(results: Sequence[HardCaseResult]) -> str:
    """One sentence."""
    failed = [result.case.name for result in results if not result.report.passed]
    if failed:
        return f"{len(failed)} of {len(results)} hard cases failed: {', '.join(failed)}."
    return "The hard case passed." if len(results) == 1 else f"All {len(results)} hard cases passed."


def markdown(results: Sequence[HardCaseResult]) -> str:
    """Introduction, table and conclusion."""
    rows = [[cell.replace("|", "\\|").replace("*", "\\*") for cell in row(result)] for result in results]
    table = markdown_table(COLUMNS, (":--",) * len(COLUMNS), rows)
    return "\n\n".join([INTRODUCTION, table, conclusion(results)]) + "\n"


def html(results: Sequence[HardCaseResult]) -> str:
    """The page: conclusion, introduction and table, the verdicts beside the names."""
    (case, *texts, verdict), rows = COLUMNS, [row(result) for result in results]
    cells = [(name, passed, *others) for name, *others, passed in rows]
    table = Table("Cases", (case, verdict, *texts), cells, texts=len(texts))
    lead = " ".join(INTRODUCTION.partition("\n")[2].replace("`", "").split())
    return Page("Hard cases", [conclusion(results)], tables=[table], lead=lead).html


def data(results: Sequence[HardCaseResult]) -> dict[str, Any]:
    """The results as plain data; a value that isn't finite is null."""
    return {
        "passed": all(result.report.passed for result in results),
        "cases": [
            {
                "name": result.case.name,
                "hard": result.case.hard,
                "happened": result.report.happened,
                "passed": result.report.passed,
                "checks": [
                    asdict(check) | {"value": check.value if isfinite(check.value) else None, "passed": check.passed}
                    for check in result.report.checks
                ],
            }
            for result in results
        ],
        "versions": versions(),
    }

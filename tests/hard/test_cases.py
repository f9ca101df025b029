"""Every hard case goes well; the same checks as `flexfmu workprec --hard` shows, fewer cycles."""

from __future__ import annotations

import pytest

from flexfmu.cosim.workprec.hard import repetition, suite
from flexfmu.cosim.workprec.hard.case import HardCase
from flexfmu.cosim.workprec.hard.report import figures

CYCLES = 200

QUICK = ("elbows 1 mm", "inputs that jump")
"""Cases that take less than a second."""


def cases() -> list[HardCase]:
    """All families, the repetition shortened."""
    full = [each.name for each in repetition.cases()]
    return [*(each for each in suite.hard_cases() if each.name not in full), *repetition.cases(CYCLES)]


def marks(case: HardCase) -> list[pytest.MarkDecorator]:
    """Slow ones are marked."""
    return [] if case.name.startswith(QUICK) else [pytest.mark.slow]


@pytest.mark.parametrize("case", [pytest.param(each, id=each.name, marks=marks(each)) for each in cases()])
def test_case_goes_well(case: HardCase) -> None:
    """No hard case blows up, lies, or leaves its branch: each is held against solvers of other people or exact invariants."""
    finding = case.run()
    assert finding.passed, f"{finding.happened}; {figures(finding)}"

"""Every hard case goes well; the same checks as `flexfmu workprec --hard` shows, fewer cycles."""

from __future__ import annotations

import pytest

from flexfmu.benchmarks.hard_cases import repetition, suite
from flexfmu.benchmarks.hard_cases.case import HardCase
from flexfmu.benchmarks.hard_cases.suite import figures

FULL = [each.name for each in repetition.cases()]
CASES = [*(each for each in suite.hard_cases() if each.name not in FULL), *repetition.cases(200)]
"""All families, the repetition shortened."""


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_case_goes_well(case: HardCase) -> None:
    """No hard case blows up, lies, or leaves its branch: each is held against solvers of other people or exact invariants."""
    finding = case.run()
    assert finding.passed, f"{finding.happened}; {figures(finding)}"

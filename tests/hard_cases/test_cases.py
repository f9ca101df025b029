"""Every hard case goes well; the same checks as `flexfmu workprec --hard` shows, fewer cycles."""

from __future__ import annotations

import pytest

from flexfmu.benchmarks.hard_cases import repetition, suite
from flexfmu.benchmarks.hard_cases.case import HardCase
from flexfmu.benchmarks.hard_cases.suite import figures

CYCLES = 200

SLOW = (
    "200 cycles",
    "elbows 1 mm",
    "motion at 26 g",
    "stiffness",
    "20 bending",
    "elbows 100",
    "elbows 5 mm",
    "gain",
    "rods of 5 mm",
    "a step of 1 s",
    "Young's modulus x 1e3",
    "elbows 20 mm",
    "no payload",
    "payload of 60 kg",
    "rods of 80 mm",
    "motion at 15 g",
    "bang-bang",
    "start away",
    "steps of 1 ns",
    "motors that stick",
    "Young's modulus x 1e-3",
    "no dwell",
    "inputs that jump",
)
"""How the names of cases begin that take more than about a second, FMUs and references of their own included."""


def cases() -> list[HardCase]:
    """All families, the repetition shortened."""
    full = [each.name for each in repetition.cases()]
    return [*(each for each in suite.hard_cases() if each.name not in full), *repetition.cases(CYCLES)]


def marks(case: HardCase) -> list[pytest.MarkDecorator]:
    """Slow ones are marked."""
    return [pytest.mark.slow] if case.name.startswith(SLOW) else []


@pytest.mark.parametrize("case", [pytest.param(each, id=each.name, marks=marks(each)) for each in cases()])
def test_case_goes_well(case: HardCase) -> None:
    """No hard case blows up, lies, or leaves its branch: each is held against solvers of other people or exact invariants."""
    finding = case.run()
    assert finding.passed, f"{finding.happened}; {figures(finding)}"

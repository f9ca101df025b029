"""What a hard case is, and what was found out when it ran."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Check:
    """One number that says whether a case went well.

    Attributes:
        name: what is measured.
        value: what was found; a NaN never passes.
        limit: the most that is right.
        unit: of both; empty for a relative number or a count.
    """

    name: str
    value: float
    limit: float
    unit: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is a number up to the limit."""
        return self.value <= self.limit

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        mark = "" if self.passed else f" (more than {self.limit:.2g}{unit})"
        return f"{self.name} {self.value:.2g}{unit}{mark}"


@dataclass(frozen=True)
class Finding:
    """What happened in a case.

    Attributes:
        happened: in words, without the figures of the checks.
        checks: what was measured, with limits.
    """

    happened: str
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """Whether all checks pass, and there are any."""
        return bool(self.checks) and all(check.passed for check in self.checks)

    def value(self, name: str) -> float:
        """The value of a check by its name."""
        return next(check.value for check in self.checks if check.name == name)


@dataclass(frozen=True)
class HardCase:
    """A case of the suite.

    Attributes:
        name: short, unique, for tables and tests.
        hard: what makes it hard, with a number.
        run: runs it.
    """

    name: str
    hard: str
    run: Callable[[], Finding]

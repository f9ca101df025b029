"""A result of validation."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How bad it is."""

    ERROR = "error"
    """The FMU breaks the standard, or does not do what it claims."""
    WARNING = "warning"
    """Some tools or machines will stumble over it."""
    NOTE = "note"
    """Something that could not be checked here."""


@dataclass(frozen=True)
class Finding:
    """Something wrong with an FMU.

    Attributes:
        check: what was looked at, for example ``binary``.
        message: where and what: one sentence with the value found.
        remedy: what would be right, or what to do.
        severity: how bad it is.
    """

    check: str
    message: str
    remedy: str = ""
    severity: Severity = Severity.ERROR

    def __str__(self) -> str:
        return f"{self.severity}: {self.check}: {self.message}" + (f"; {self.remedy}" if self.remedy else "")

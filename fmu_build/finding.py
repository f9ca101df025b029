"""A result of validation."""

from __future__ import annotations

from dataclasses import dataclass

REPORT = "findings: "
"""Begin of the line with the findings, among whatever an FMU prints."""


@dataclass(frozen=True)
class Finding:
    """Something wrong with an FMU.

    Attributes:
        check: what was looked at, for example ``binary``.
        message: one sentence with the value found and what would be right.
    """

    check: str
    message: str

    def __str__(self) -> str:
        return f"{self.check}: {self.message}"

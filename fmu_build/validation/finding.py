"""Findings of the validation: grouped, sorted by severity."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum

from flexfmu.errors import shortened


class Severity(StrEnum):
    """Severity of a finding."""

    ERROR = "error"
    """The FMU violates the standard or one of its own claims."""
    WARNING = "warning"
    """The FMU fails in some tools or on some machines."""
    NOTE = "note"
    """A property that could not be checked here."""


SECTIONS = {
    "instantiation": "2.1.5",
    "simulation": "4.2.2",
    "model description": "2.2",
    "archive": "2.3",
    "binary": "2.3",
    "guid": "2.1.5",
    "start value": "2.2.7",
    "parameters": "2.1.7",
    "tunable parameters": "2.2.7",
    "initialisation": "2.1.7",
    "start time": "2.1.6",
    "logging": "2.1.5",
    "repeatability": "2.1.6",
    "reset": "2.1.6",
    "several variables": "2.1.7",
    "reading": "2.1.7",
    "instances": "2.1.5",
    "state": "2.1.8",
    "inputs in the state": "2.1.8",
    "serialisation": "2.1.8",
    "derivatives": "3.2.2",
    "states": "3.2.1",
    "integrator steps": "3.2.2",
    "event indicators": "3.2.2",
    "interfaces": "4.1",
    "rates": "2.2.7",
    "dependencies of variables": "2.2.8",
    "directional derivatives": "2.1.9",
    "output derivatives": "4.2.1",
    "input derivatives": "4.2.1",
    "variable step": "4.2.2",
    "last successful time": "4.2.3",
    "time events": "3.2.2",
    "time": "2.2.7",
    "value reference": "2.2.7",
    "range": "2.2.7",
    "units": "2.2.2",
    "nominal": "2.2.7",
    "experiment": "2.2.5",
    "resource location": "2.1.5",
    "memory": "2.1.5",
    "calls": "2.1.3",
    "process": "2.1.5",
    "sources": "2.3",
    "dependencies": "2.3",
}
"""Name of the check → section of FMI 2.0.4; the most harmful first."""

NAMES_SHOWN = 4
"""Most names of further variables or files that one line lists."""


@dataclass(frozen=True)
class Finding:
    """A defect of an FMU, of one or many of its variables or files.

    Attributes:
        message: location and defect, one sentence with the value found.
        remedy: what to do.
        severity: error, warning or note.
        subject: variable or file concerned; may be empty.
        check: name of the check, for example ``binary``; what runs the check fills it in, see `named`.
        section: section of FMI 2.0.4, or of another named standard; by default the section of the check.
        others: subjects of further findings of the same kind, or names of other checks with the same message.
    """

    message: str
    remedy: str = ""
    severity: Severity = Severity.ERROR
    subject: str = ""
    check: str = ""
    section: str = ""
    others: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.section:
            object.__setattr__(self, "section", SECTIONS.get(self.check, ""))

    def __str__(self) -> str:
        names = ", ".join(self.others[:NAMES_SHOWN]) + (", ..." if len(self.others) > NAMES_SHOWN else "")
        more = f" (and {len(self.others)} more: {names})" if self.others else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        standard = "" if self.section.startswith("FMI") else "FMI 2.0.4, "
        section = f" [{standard}{self.section}]" if self.section else ""
        return shortened(f"{self.severity}: {self.check}: {self.message}{more}{remedy}{section}")


def named(check: str, findings: Iterable[Finding]) -> Iterator[Finding]:
    """Yield the findings, with the name of the check where they have none."""
    for finding in findings:
        yield finding if finding.check else replace(finding, check=check)


def ranked(findings: Iterable[Finding]) -> list[Finding]:
    """Findings with equal ones merged; errors first, then the most harmful checks.

    Findings are equal if they differ only by subject and values, or have the same message in several checks.
    """
    # merge findings that differ only by subject and values
    alike = _merged(findings, _kind, lambda finding: finding.subject or finding.message)
    # the worst first
    checks, severities = list(SECTIONS), list(Severity)
    alike.sort(
        key=lambda finding: (
            severities.index(finding.severity),
            checks.index(finding.check) if finding.check in checks else len(checks),
        )
    )
    # merge checks with the same message: one cause may end several checks
    return _merged(alike, lambda finding: (finding.severity, finding.message), lambda finding: finding.check)


def _merged(
    findings: Iterable[Finding], kind: Callable[[Finding], object], name: Callable[[Finding], str]
) -> list[Finding]:
    """The first finding of each kind, with the names of the others."""
    groups: dict[object, list[Finding]] = {}
    for finding in dict.fromkeys(findings):
        groups.setdefault(kind(finding), []).append(finding)
    return [replace(first, others=first.others + tuple(map(name, rest))) for first, *rest in groups.values()]


_DIFFERING = re.compile(r"""'[^']*'|"[^"]*"|\b(True|False|nan|inf)\b|[-+]?\d+(\.\d*)?([eE][-+]?\d+)?""")
"""Values in a message: quoted texts, True, False, nan, inf, numbers."""


def _kind(finding: Finding) -> object:
    """Key that is equal for findings that differ only by subject and values."""
    subject = rf"(?<!\w){re.escape(finding.subject)}(?!\w)"
    message = re.sub(subject, "#", finding.message) if finding.subject else finding.message
    return finding.check, finding.severity, finding.remedy, finding.section, _DIFFERING.sub("#", message)

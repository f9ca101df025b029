"""A line of `make bench`: what was measured, its value and its target. Not a script of its own."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SpeedFigure:
    """A measured figure.

    Attributes:
        name: what was measured.
        value: its value in the unit.
        target: what it should be.
        unit: ms, µs, s, or × for a ratio.
        at_least: whether more is better; otherwise less.
        note: remarks.
    """

    name: str
    value: float
    target: float
    unit: str
    at_least: bool = False
    note: str = ""

    @property
    def met(self) -> bool:
        """Whether the target is met."""
        return self.value >= self.target if self.at_least else self.value <= self.target

    def line(self) -> str:
        """One line of the table."""
        comparison = "≥" if self.at_least else "≤"
        verdict = "met" if self.met else "missed"
        return f"{self.name:53} {self.value:9.2f} {self.unit:2}  {comparison} {self.target:<6g} {verdict:7} {self.note}"

"""Parameters whose whole numbers have names: how FMUs show the choice of an initial state, a method, a limit.

FMI has enumerations for it, but not every importer takes them: Maestro 3.1.1 stops with "Enumeration not supported". So by
default they are Integers from 1 on whose descriptions say what the numbers mean; tools that know a choice by name find the names
in the vendor annotation `ANNOTATION`. Enumerations are an option of the build; numbers and value references stay the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

ANNOTATION = "Choices"
"""Vendor annotation with an attribute for each choice, such as ``initial="static=1 undeformed=2"``."""

Items = Mapping[str, tuple[int, str]]
"""Name → (number, meaning)."""


@dataclass(frozen=True)
class Choice:
    """A parameter of type Integer whose values have names.

    Attributes:
        name: of the parameter.
        description: what it chooses.
        items: its values, numbered from 1 without a gap.
    """

    name: str
    description: str
    items: Items

    @property
    def type_name(self) -> str:
        """Name of its enumeration type."""
        return f"{self.name.title().replace('_', '').replace('.', '')}Choice"

    @property
    def text(self) -> str:
        """The description with every number, its name and meaning."""
        return f"{self.description}: " + "; ".join(
            f"{number} {name}: {meaning}" for name, (number, meaning) in self.items.items()
        )

    @property
    def limits(self) -> tuple[int, int]:
        """Smallest and largest number."""
        numbers = [number for number, _ in self.items.values()]
        return min(numbers), max(numbers)

    def name_of(self, number: float | None) -> str:
        """The name of a value."""
        return next(name for name, (value, _) in self.items.items() if value == number)


INITIAL = Choice(
    "initial",
    "Elastic state at the start",
    {
        "static": (1, "static equilibrium at the start pose, motors locked"),
        "undeformed": (2, "elastic coordinates and rates zero"),
    },
)


def annotation(choices: Iterable[Choice]) -> dict[str, dict[str, str]]:
    """The names of all values, as a vendor annotation; empty where there is no choice."""
    attributes = {
        choice.name: " ".join(f"{name}={number}" for name, (number, _) in choice.items.items()) for choice in choices
    }
    return {ANNOTATION: attributes} if attributes else {}

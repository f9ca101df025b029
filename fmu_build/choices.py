"""Parameters with named values, such as the initial state or the integration method.

Not every importer accepts FMI enumerations: Maestro 3.1.1 fails with "Enumeration not supported". By default such parameters
are therefore Integers from 1, with the names in the description and in the vendor annotation `ANNOTATION`. Enumerations are an
option of the build, with the same numbers and value references.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

ANNOTATION = "Choices"
"""Vendor annotation with an attribute for each choice, such as ``initial="static=1 undeformed=2"``."""

Items = Mapping[str, tuple[int, str]]
"""Name → (number, meaning)."""


@dataclass(frozen=True)
class ChoiceParameter:
    """A parameter of type Integer whose values have names.

    Attributes:
        name: name of the parameter.
        description: what it chooses.
        items: its values, numbered from 1 without gaps.
    """

    name: str
    description: str
    items: Items

    @property
    def type_name(self) -> str:
        """Name of the enumeration type."""
        return f"{self.name.title().replace('_', '').replace('.', '')}Choice"

    @property
    def text(self) -> str:
        """The description with every number, its name and meaning."""
        return f"{self.description}: " + "; ".join(
            f"{number} {name}: {meaning}" for name, (number, meaning) in self.items.items()
        )

    def name_of(self, number: float | None) -> str:
        """The name of a value."""
        return next(name for name, (value, _) in self.items.items() if value == number)


INITIAL = ChoiceParameter(
    "initial",
    "Elastic state at the start",
    {
        "static": (1, "static equilibrium at the start pose, motors locked"),
        "undeformed": (2, "elastic coordinates and rates zero"),
    },
)

LEAST_TOLERANCE = 1e-12
"""Lower limit of the relative tolerance; smaller ones are raised to it, see ``c-runtime/plant/plant_backend.c``."""

FIXED_STEP = "integrator.step"
"""Name of the parameter for a fixed step size [s]; 0 selects error control."""

INTEGRATOR_REFERENCE = 6
"""Value reference of the parameter ``integrator``, after ``initial`` and the counters."""

INTEGRATOR = ChoiceParameter(
    "integrator",
    "Integration method",
    {
        "automatic": (
            1,
            "the cheapest of radau3, gauss3 and gauss4 for the tolerance; no radau3 where nothing damps the vibrations",
        ),
        "gauss2": (2, "Gauss collocation, 2 stages, order 4, A-stable, without damping of its own"),
        "gauss3": (3, "Gauss collocation, 3 stages, order 6, A-stable, without damping of its own"),
        "gauss4": (4, "Gauss collocation, 4 stages, order 8, A-stable, without damping of its own"),
        "radau3": (5, "Radau IIA, 3 stages, order 5, L-stable: damps what it does not resolve"),
        "dopri5": (6, "Dormand-Prince, explicit, order 5 with an error estimate of order 4"),
        "rk4": (7, "Classical Runge-Kutta method, explicit, order 4"),
        "radau3-dense": (8, "radau3 with steps beyond communication points, where the motion is interpolated"),
    },
)
"""The integration method; the numbers are those of ``c-runtime/solver/methods.h``."""


def annotation(choices: Iterable[ChoiceParameter]) -> dict[str, dict[str, str]]:
    """Vendor annotation with the names of all values; empty if there are no choices."""
    attributes = {
        choice.name: " ".join(f"{name}={number}" for name, (number, _) in choice.items.items()) for choice in choices
    }
    return {ANNOTATION: attributes} if attributes else {}

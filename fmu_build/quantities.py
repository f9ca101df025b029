"""Physical quantities: each unit of the models belongs to one, and each quantity is a type of the model description."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from flexfmu.fmu_build.units import DIMENSIONLESS, display_unit


@dataclass(frozen=True)
class RealType:
    """A type of real variables.

    Attributes:
        name: its name, also the quantity's, as the Modelica standard library spells them.
        unit: the one unit of its variables.
        display_unit: what a person would rather read; None for the unit itself.
    """

    name: str
    unit: str
    display_unit: str | None


_QUANTITIES: Mapping[str, str] = {
    "rad": "Angle",
    "rad/s": "AngularVelocity",
    "rad/s2": "AngularAcceleration",
    "rad/s3": "AngularJerk",
    "m": "Length",
    "m/s": "Velocity",
    "m/s2": "Acceleration",
    "m/s3": "Jerk",
    "m2": "Area",
    "m4": "SecondMomentOfArea",
    "kg": "Mass",
    "kg/m": "LinearDensity",
    "kg/m3": "Density",
    "kg.m2": "MomentOfInertia",
    "N": "Force",
    "N.m": "Torque",
    "N/m": "TranslationalSpringConstant",
    "N.m/rad": "RotationalSpringConstant",
    "N.s/m": "TranslationalDampingConstant",
    "N.m.s/rad": "RotationalDampingConstant",
    "N.m2": "FlexuralRigidity",
    "Pa": "Pressure",
    "J": "Energy",
    "W": "Power",
    "s": "Time",
    "Hz": "Frequency",
}
"""Unit → quantity."""


def quantity(unit: str) -> str | None:
    """Name of the quantity that is measured in ``unit``, None where it has no name of its own."""
    return _QUANTITIES.get(unit)


def real_types(units: Iterable[str]) -> tuple[RealType, ...]:
    """Types of the variables with these units, each once, sorted by name."""
    named = {name: unit for unit in set(units) - {DIMENSIONLESS} if (name := quantity(unit)) is not None}
    return tuple(RealType(name, unit, display_unit(unit)) for name, unit in sorted(named.items()))

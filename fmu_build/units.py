"""Units as FMI wants them, a spelling such as ``N.m`` or ``rad/s2`` → exponents of the SI base units, and their quantities."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import pi

from flexfmu.fmu_build.errors import ModelError

DIMENSIONLESS = "1"

_SYMBOLS: Mapping[str, Mapping[str, int]] = {
    "1": {},
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "rad": {"rad": 1},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
}
"""Coherent units and their exponents; a prefix would bring a factor, which the models don't use."""

_BASE_UNITS = ("kg", "m", "s", "A", "K", "rad")
"""Order in which FMI's schema lists the base units."""

_DEGREE = 180.0 / pi


@dataclass(frozen=True)
class DisplayUnit:
    """A display unit: its number there is ``factor`` times the one in the model's unit."""

    name: str
    factor: float


_DISPLAY_UNITS: Mapping[str, tuple[DisplayUnit, ...]] = {
    "rad": (DisplayUnit("deg", _DEGREE),),
    "rad/s": (DisplayUnit("deg/s", _DEGREE), DisplayUnit("rpm", 30.0 / pi)),
    "rad/s2": (DisplayUnit("deg/s2", _DEGREE),),
    "m": (DisplayUnit("mm", 1e3), DisplayUnit("um", 1e6)),
    "m/s": (DisplayUnit("mm/s", 1e3),),
    "s": (DisplayUnit("ms", 1e3),),
    "Pa": (DisplayUnit("GPa", 1e-9), DisplayUnit("MPa", 1e-6)),
}
"""Display units; the first is the default of the variables, but for those in `_READ_AS_THEY_ARE`."""

_READ_AS_THEY_ARE = {"m/s", "s"}
"""Units whose display units are offered, but aren't the default."""

_FACTOR = re.compile(r"(?P<sign>^|[./])(?P<symbol>1|[A-Za-z]+)(?P<power>\d*)")


@dataclass(frozen=True)
class Unit:
    """A unit of the model description.

    Attributes:
        name: its spelling.
        exponents: base unit → exponent, zeros left out, in the schema's order.
        displays: units to choose from for showing it; the model's units are coherent, so their own factor is 1.
    """

    name: str
    exponents: Mapping[str, int]
    displays: tuple[DisplayUnit, ...] = ()


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
"""Unit → physical quantity: each unit of the models belongs to one, and each quantity is a type of the model description."""


@dataclass(frozen=True)
class RealType:
    """A type of real variables.

    Attributes:
        name: its name, also the quantity's, as the Modelica standard library spells them.
        unit: the one unit of its variables.
        display_unit: in which tools show its values; None for the unit itself.
    """

    name: str
    unit: str
    display_unit: str | None


def unit_exponents(name: str) -> dict[str, int]:
    """Exponents of the SI base units of ``name``; ``.`` multiplies, ``/`` divides by the one symbol after it.

    Raises:
        ModelError: a symbol is unknown or the spelling is not understood.
    """
    # the spelling, factor by factor
    factors = list(_FACTOR.finditer(name))
    if "".join(factor.group() for factor in factors) != name or not factors:
        raise ModelError(f"unit '{name}' is not understood; write it like N.m or rad/s2")
    # exponents add up
    total = dict.fromkeys(_BASE_UNITS, 0)
    for factor in factors:
        symbol = factor["symbol"]
        if symbol not in _SYMBOLS:
            raise ModelError(f"unit '{name}' has the unknown symbol '{symbol}'; known are {', '.join(_SYMBOLS)}")
        power = int(factor["power"] or 1) * (-1 if factor["sign"] == "/" else 1)
        for base, exponent in _SYMBOLS[symbol].items():
            total[base] += power * exponent
    return {base: exponent for base, exponent in total.items() if exponent}


def display_unit(name: str) -> str | None:
    """Name of the display unit of ``name``, None for the unit itself."""
    return _DISPLAY_UNITS[name][0].name if name in _DISPLAY_UNITS and name not in _READ_AS_THEY_ARE else None


def displayed(value: float, unit: str) -> str | None:
    """A value in its display unit, such as ``240 mm``; None where that is the unit itself."""
    name = display_unit(unit)
    return None if name is None else f"{value * _DISPLAY_UNITS[unit][0].factor:.6g} {name}"


def unit_definitions(names: Iterable[str]) -> tuple[Unit, ...]:
    """Definitions of the units in ``names``, each once, sorted; numbers without a unit need none."""
    used = sorted(set(names) - {DIMENSIONLESS})
    return tuple(Unit(name, unit_exponents(name), _DISPLAY_UNITS.get(name, ())) for name in used)


def quantity(unit: str) -> str | None:
    """Name of the quantity that is measured in ``unit``, None where it has no name of its own."""
    return _QUANTITIES.get(unit)


def real_types(units: Iterable[str]) -> tuple[RealType, ...]:
    """Types of the variables with these units, each once, sorted by name."""
    named = {name: unit for unit in set(units) - {DIMENSIONLESS} if (name := quantity(unit)) is not None}
    return tuple(RealType(name, unit, display_unit(unit)) for name, unit in sorted(named.items()))

"""Unit names such as ``N.m`` or ``rad/s2``: factor and exponents of the SI base units, display units, physical quantities."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isnan, nan, pi

from flexfmu.fmu_build.errors import ModelError

DIMENSIONLESS = "1"

Exponents = Mapping[str, int]
"""Base unit → exponent."""

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
"""Base units in the order of FMI's schema."""

_COHERENT: dict[str, Exponents] = {
    "1": {},
    **{base: {base: 1} for base in BASE_UNITS},
    "Hz": {"s": -1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "S": {"kg": -1, "m": -2, "s": 3, "A": 2},
    "F": {"kg": -1, "m": -2, "s": 4, "A": 2},
    "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
    "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "T": {"kg": 1, "s": -2, "A": -1},
}
"""Coherent units → exponents of the base units; the models use no others."""

_OTHERS: dict[str, tuple[float, Exponents]] = {
    "g": (1e-3, {"kg": 1}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
    "Hz": (nan, {"s": -1}),  # with or without 2 pi: both are in use
    "deg": (pi / 180.0, {"rad": 1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "d": (86400.0, {"s": 1}),
    "degC": (1.0, {"K": 1}),
}
"""Other units, in descriptions of other tools → factor to SI units and exponents."""

_SYMBOLS = {symbol: (1.0, exponents) for symbol, exponents in _COHERENT.items()} | _OTHERS
_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
_NEVER_PREFIXED = {"1", "kg", "rad", "Hz", "deg", "min", "h", "d", "degC"}
_FACTOR = re.compile(r"(?P<symbol>1|[A-Za-z]+)\^?(?P<power>-?\d+)?")
_QUOTIENT = re.compile(r"(?P<above>[^/()]+)(/\((?P<product>[^/()]+)\)|(?P<factors>(/[^/().*]+)*))")
"""a.b, a/b, a/b/c and a/(b.c), but not a/b.c, which is ambiguous."""

_DEGREE = 180.0 / pi


@dataclass(frozen=True)
class DisplayUnit:
    """A display unit: displayed value = ``factor`` * value in the model's unit."""

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
"""Unit → display units; the first is the default, except for units in `_READ_AS_THEY_ARE`."""

_READ_AS_THEY_ARE = {"m/s", "s"}
"""Units that are themselves the default for display."""


@dataclass(frozen=True)
class Unit:
    """A unit of the model description.

    Attributes:
        name: name of the unit.
        exponents: base unit → exponent, without zeros, in the schema's order; the factor is 1.
        displays: display units.
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
"""Unit → physical quantity, which is the name of a type in the model description."""


@dataclass(frozen=True)
class RealType:
    """A type of real variables.

    Attributes:
        name: name of the type and of the quantity, spelt as in the Modelica Standard Library.
        unit: unit of all its variables.
        display_unit: default display unit; None for the unit itself.
    """

    name: str
    unit: str
    display_unit: str | None


def meaning(name: str) -> tuple[float, dict[str, int]] | None:
    """Factor to SI units (NaN if ambiguous) and exponents of all base units that the name of a unit implies.

    None if the name is unknown or ambiguous. Source: BIPM, The International System of Units, 9th edition.
    """
    factor, exponents = 1.0, dict.fromkeys(BASE_UNITS, 0)
    form = _QUOTIENT.fullmatch(name.replace(" ", ""))
    if form is None:
        return None
    # factors of the numerator, then of the denominator
    below = [form["product"]] if form["product"] else form["factors"].split("/")[1:]
    for sign, product in ((1, form["above"]), *((-1, part) for part in below)):
        for part in re.split(r"[.*]", product):
            match = _FACTOR.fullmatch(part)
            symbol, prefix = match["symbol"] if match else "", 1.0
            if symbol not in _SYMBOLS and symbol[1:] not in _NEVER_PREFIXED:
                symbol, prefix = symbol[1:], _PREFIXES.get(symbol[:1], nan)
            if match is None or symbol not in _SYMBOLS or isnan(prefix):
                return None
            size, units = _SYMBOLS[symbol]
            power = sign * int(match["power"] or 1)
            factor *= (prefix * size) ** power
            for base, exponent in units.items():
                exponents[base] += power * exponent
    return factor, exponents


def unit_exponents(name: str) -> dict[str, int]:
    """Base unit → exponent of a coherent unit, without zeros, in the schema's order.

    Raises:
        ModelError: the name has an unknown symbol, a prefix or a wrong syntax.
    """
    known = meaning(name) if re.fullmatch(r"[A-Za-z0-9./()]+", name) else None
    if known is None or not (known[0] == 1.0 or isnan(known[0])):
        raise ModelError(
            f"unit '{name}' isn't known; write it like N.m or rad/s2, with the symbols {', '.join(_COHERENT)}"
        )
    return {base: exponent for base, exponent in known[1].items() if exponent}


def display_unit(name: str) -> str | None:
    """Default display unit of the unit ``name``; None for the unit itself."""
    return _DISPLAY_UNITS[name][0].name if name in _DISPLAY_UNITS and name not in _READ_AS_THEY_ARE else None


def displayed(value: float, unit: str) -> str | None:
    """A value in its default display unit, such as ``240 mm``; None for the unit itself."""
    name = display_unit(unit)
    return None if name is None else f"{value * _DISPLAY_UNITS[unit][0].factor:.6g} {name}"


def unit_definitions(names: Iterable[str]) -> tuple[Unit, ...]:
    """Definitions of the units in ``names``, unique and sorted, without the dimensionless one."""
    used = sorted(set(names) - {DIMENSIONLESS})
    return tuple(Unit(name, unit_exponents(name), _DISPLAY_UNITS.get(name, ())) for name in used)


def quantity(unit: str) -> str | None:
    """Name of the physical quantity with this unit; None if it has no name."""
    return _QUANTITIES.get(unit)


def real_types(units: Iterable[str]) -> tuple[RealType, ...]:
    """Types of variables with these units, unique and sorted by name."""
    named = {name: unit for unit in set(units) - {DIMENSIONLESS} if (name := quantity(unit)) is not None}
    return tuple(RealType(name, unit, display_unit(unit)) for name, unit in sorted(named.items()))

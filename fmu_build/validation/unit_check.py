"""Checks that unit definitions (SI exponents, factors) match the names of the units.

Ambiguous names, such as a/b.c, are not checked. Source: BIPM, The International System of Units, 9th edition.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from flexfmu.fmu_build.units import COHERENT
from flexfmu.fmu_build.validation.finding import Finding

Exponents = dict[str, int]

BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
"""Base units whose exponents are checked; rad is not, since an angle may also have the unit 1."""

_SYMBOLS: dict[str, tuple[float, Exponents]] = {
    **{
        symbol: (1.0, {b: e for b, e in units.items() if b != "rad"})
        for symbol, units in COHERENT.items()
        if symbol not in ("kg", "Hz")
    },
    "g": (1e-3, {"kg": 1}),
    "mol": (1.0, {"mol": 1}),
    "cd": (1.0, {"cd": 1}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "Ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "S": (1.0, {"kg": -1, "m": -2, "s": 3, "A": 2}),
    "F": (1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
    "Wb": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -1}),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
}
"""Symbols that may have a prefix → factor and exponents."""

_PLAIN: dict[str, tuple[float, Exponents]] = {
    "Hz": (math.nan, {"s": -1}),  # with or without 2 pi: both are in use
    "deg": (math.pi / 180.0, {}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "d": (86400.0, {"s": 1}),
    "degC": (1.0, {"K": 1}),
}
"""Symbols without prefixes → factor and exponents."""

_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
_FACTOR = re.compile(r"(?P<symbol>1|[A-Za-z]+)\^?(?P<power>-?\d+)?")
_QUOTIENT = re.compile(r"(?P<above>[^/()]+)(/\((?P<product>[^/()]+)\)|(?P<factors>(/[^/().*]+)*))")
"""a.b, a/b, a/b/c and a/(b.c), but not a/b.c, which is ambiguous."""

_CLOSE = 1e-3


@dataclass(frozen=True)
class Meaning:
    """Factor to SI units, NaN if ambiguous, and exponents of the base units."""

    factor: float
    exponents: Exponents


def meaning(name: str) -> Meaning | None:
    """Factor and exponents that the name of a unit implies; None if the name is unknown or ambiguous."""
    factor, exponents = 1.0, dict.fromkeys(BASE, 0)
    form = _QUOTIENT.fullmatch(name.replace(" ", ""))
    if form is None:
        return None
    # factors of the numerator, then of the denominator
    below = [form["product"]] if form["product"] else form["factors"].split("/")[1:]
    for sign, product in ((1, form["above"]), *((-1, part) for part in below)):
        for part in re.split(r"[.*]", product):
            match = _FACTOR.fullmatch(part)
            known = _symbol(match["symbol"]) if match else None
            if match is None or known is None:
                return None
            power = sign * int(match["power"] or 1)
            factor *= known[0] ** power
            for base, exponent in known[1].items():
                exponents[base] += power * exponent
    return Meaning(factor, exponents)


def _symbol(text: str) -> tuple[float, Exponents] | None:
    for table in (_PLAIN, _SYMBOLS):
        if text in table:
            return table[text]
    prefix, rest = _PREFIXES.get(text[:1]), _SYMBOLS.get(text[1:])
    return (prefix * rest[0], rest[1]) if prefix and rest and text[1:] not in ("1", "rad") else None


def check_units(root: Element) -> Iterator[Finding]:
    """Yield findings about exponents, factors and display units.

    Raises:
        ValueError: an exponent or factor is not a number.

    Args:
        root: the element fmiModelDescription.
    """
    for unit in root.iterfind("UnitDefinitions/Unit"):
        name, base = unit.get("name", ""), unit.find("BaseUnit")
        known = meaning(name)
        if known is not None and base is not None:
            # exponents of the base units
            given = {each: int(base.get(each, "0")) for each in BASE}
            if wrong := [each for each in BASE if given[each] != known.exponents[each]]:
                shown = " ".join(f"{each}={given[each]}" for each in wrong)
                right = " ".join(f"{each}={known.exponents[each]}" for each in wrong)
                yield Finding("units", f"{name} is defined with {shown}", f"a {name} has {right}", subject=name)
                continue
            # factor to SI units
            factor = float(base.get("factor", "1"))
            if not math.isnan(known.factor) and abs(factor - known.factor) > _CLOSE * known.factor:
                message = f"{name} is defined with the factor {factor:g}"
                yield Finding("units", message, f"a {name} has {known.factor:g}", subject=name)
        yield from _check_displays(unit, known)


def _check_displays(unit: Element, known: Meaning | None) -> Iterator[Finding]:
    for display in unit.iterfind("DisplayUnit"):
        name, factor = display.get("name", ""), float(display.get("factor", "1"))
        shown = meaning(name)
        if factor == 0.0:
            yield Finding(
                "units",
                f"the display unit {name} has the factor 0",
                "give value = factor * unit + offset",
                subject=name,
            )
        elif shown and known and shown.exponents == known.exponents and shown.factor > 0.0:
            right = known.factor / shown.factor
            if abs(factor - right) > _CLOSE * right:
                message = f"the display unit {name} of {unit.get('name')} has the factor {factor:g}"
                yield Finding("units", message, f"it is {right:g}: value = factor * unit + offset", subject=name)

"""Units of the model description."""

from __future__ import annotations

from math import pi

import pytest

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.units import display_unit, real_types, unit_definitions, unit_exponents


def test_exponents_are_those_of_the_si() -> None:
    """Importers convert by these exponents, so they must be the SI's; two spellings of one unit have one set of them."""
    assert unit_exponents("1") == unit_exponents("m/m") == {}
    assert unit_exponents("N.m") == unit_exponents("J") == {"kg": 1, "m": 2, "s": -2}
    assert unit_exponents("Pa") == unit_exponents("N/m2") == unit_exponents("J/m3") == {"kg": 1, "m": -1, "s": -2}
    assert unit_exponents("rad/s2") == {"s": -2, "rad": 1}
    assert unit_exponents("N.m.s/rad") == {"kg": 1, "m": 2, "s": -1, "rad": -1}
    assert unit_exponents("1/s") == {"s": -1}


@pytest.mark.parametrize("name", ["", "furlong", "N*m", "m/", "m^2", " m", "mm"])
def test_unknown_spelling_is_refused(name: str) -> None:
    """A misspelt unit must not reach an importer as a dimensionless one."""
    with pytest.raises(ModelError, match="unit"):
        unit_exponents(name)


def test_display_units_convert_what_is_shown() -> None:
    """A quarter turn per second reads 90 deg/s and 15 rpm; tools multiply by the factor."""
    (unit,) = unit_definitions(["rad/s"])
    assert {each.name: each.factor * pi / 2 for each in unit.displays} == pytest.approx({"deg/s": 90.0, "rpm": 15.0})
    assert (display_unit("rad/s"), display_unit("s")) == ("deg/s", None)


def test_equal_models_have_equal_lists() -> None:
    """Whatever the order of their variables: units are sorted, those of one unit share a type; numbers have neither."""
    assert [unit.name for unit in unit_definitions(["s", "1", "m", "s"])] == ["m", "s"]
    types = [(each.name, each.unit, each.display_unit) for each in real_types(["N.m", "rad", "1", "rad", "kg.m5"])]
    assert types == [("Angle", "rad", "deg"), ("Torque", "N.m", None)]

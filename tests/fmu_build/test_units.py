"""Units of the model description."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import pi

import pytest

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.sources import plant_description
from flexfmu.fmu_build.units import display_unit, real_types, unit_definitions, unit_exponents
from flexfmu.model.symbolic import SymbolicModel


@pytest.mark.parametrize(
    ("name", "exponents"),
    [
        ("1", {}),
        ("N.m", {"kg": 1, "m": 2, "s": -2}),
        ("Pa", {"kg": 1, "m": -1, "s": -2}),
        ("rad/s2", {"s": -2, "rad": 1}),
        ("kg/m3", {"kg": 1, "m": -3}),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("1/s", {"s": -1}),
        ("m/m", {}),
    ],
)
def test_exponents_are_those_of_the_si(name: str, exponents: dict[str, int]) -> None:
    """Importers convert by these exponents, so they must be the SI's."""
    assert unit_exponents(name) == exponents


def test_pascal_is_newton_per_square_metre() -> None:
    """Two spellings of one unit have one set of exponents."""
    assert unit_exponents("Pa") == unit_exponents("N/m2") == unit_exponents("J/m3")


@pytest.mark.parametrize("name", ["", "furlong", "N*m", "m/", "m^2", " m", "mm"])
def test_unknown_spelling_is_refused(name: str) -> None:
    """A misspelt unit must not reach an importer as a dimensionless one."""
    with pytest.raises(ModelError, match="unit"):
        unit_exponents(name)


def test_definitions_are_sorted_and_leave_numbers_out() -> None:
    """Equal models have equal descriptions, whatever the order of their variables."""
    assert [unit.name for unit in unit_definitions(["s", "1", "m", "s"])] == ["m", "s"]


def test_display_units_convert_what_is_shown() -> None:
    """A quarter turn per second reads 90 deg/s and 15 rpm; tools multiply by the factor."""
    (unit,) = unit_definitions(["rad/s"])
    assert {each.name: each.factor * pi / 2 for each in unit.displays} == pytest.approx({"deg/s": 90.0, "rpm": 15.0})
    assert display_unit("rad/s") == "deg/s"
    assert display_unit("s") is None


def test_every_quantity_has_one_type() -> None:
    """Variables of one unit share a type; numbers and unnamed units have none."""
    types = real_types(["N.m", "rad", "1", "rad", "kg.m5"])
    assert [(each.name, each.unit, each.display_unit) for each in types] == [
        ("Angle", "rad", "deg"),
        ("Torque", "N.m", None),
    ]


def test_types_can_be_told_from_variables(make_oscillators: Callable[..., SymbolicModel]) -> None:
    """FMI wants every type's name to differ from every variable's: a model that breaks this is refused."""
    model = make_oscillators()
    mass = replace(model.parameters[0], name="Mass")
    with pytest.raises(ModelError, match="variable 'Mass' has the name of a type"):
        plant_description(replace(model, parameters=(mass, *model.parameters[1:])))

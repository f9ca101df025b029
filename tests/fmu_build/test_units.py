"""Units of the model description."""

from __future__ import annotations

import pytest

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.units import unit_definitions, unit_exponents


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

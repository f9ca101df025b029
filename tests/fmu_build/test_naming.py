"""Flat names, a rule that can be undone; and units of the model description."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import pi
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.model_description import read_model_description

from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.naming import flat_name, structured_names
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.units import display_unit, real_types, unit_definitions, unit_exponents
from flexfmu.model.symbolic import SymbolicModel


def test_names_are_flattened_as_documented() -> None:
    """Scripts are written against these names, each of which is found again."""
    flat = {
        "end_effector.position.x": "end_effector_position_x",
        "der(link11.bending[1])": "der_link11_bending_1",
        "der(link11.bending[1],2)": "der2_link11_bending_1",
        "a[1,2].b": "a_1_2_b",
        "a_1": "a_1",
    }
    assert {name: flat_name(name) for name in flat} == flat
    assert structured_names(flat) == {new: name for name, new in flat.items() if new != name}


@pytest.mark.parametrize("name", ["'quoted name'", "1a", "größe"])
def test_names_without_a_flat_one_are_refused(name: str) -> None:
    """The message says what names look like."""
    with pytest.raises(ModelError, match="has no flat name; use names like"):
        flat_name(name)


@pytest.mark.slow
def test_flat_fmu_is_valid_and_computes_the_same(make_oscillators: Callable[..., SymbolicModel]) -> None:
    """The names change and nothing else: fmpy's checks of flat names pass, its results are equal."""
    paths = [build_fmu(make_oscillators(), stop_time=0.1, naming=naming).path for naming in ("structured", "flat")]
    description = read_model_description(str(paths[1]), validate_variable_names=True)
    assert description.variableNamingConvention == "flat"
    structured, flat = (
        fmpy.simulate_fmu(str(path), output=[name])
        for path, name in zip(paths, ("der(first.position)", "der_first_position"), strict=True)
    )
    np.testing.assert_array_equal(structured["der(first.position)"], flat["der_first_position"])


def test_our_own_master_sees_the_structured_names(
    make_oscillators: Callable[..., SymbolicModel], tmp_path: Path
) -> None:
    """A flat FMU of ours connects by the names of the scene; names that are flattened alike are refused at build time, with both."""
    model = make_oscillators()
    built = build_fmu(model, naming="flat", output=tmp_path / "flat.fmu")
    names = {variable.name for variable in open_fmu(built.path).description.modelVariables}
    assert {*(variable.name for variable in model.outputs), "statistics.steps"} <= names
    wrong = replace(model.parameters[0], name="first_position")
    expected = r"'first_position' and 'first\.position' have the same flat name, first_position"
    with pytest.raises(ModelError, match=expected):
        generate_sources(replace(model, parameters=(wrong, *model.parameters[1:])), DefaultExperiment(), "flat")


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

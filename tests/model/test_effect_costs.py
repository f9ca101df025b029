"""What an effect costs where it isn't chosen, which is nothing, and what the paper's model costs."""

from __future__ import annotations

import inspect
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from flexfmu.fmu_build.codegen import generate_functions
from flexfmu.model.effects import Effect
from flexfmu.model.five_bar import effect_classes
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicModel

BARE = {
    "payload.mass": 0.0,
    "effects": {"gravity": [0.0, 0.0], "basis": "craig-bampton", "proximal_bending": 1, "distal_axial": 1},
}


@lru_cache
def bare(drive: str = "motion") -> SymbolicModel:
    """The model of a scene without any effect that can be left out."""
    return build_model(load_scene("barnard2012-6kg").replace(BARE | {"cosimulation.drive": drive}))


def stands_still(kind: str, *keys: str) -> dict[str, Any]:
    """A damping whose coefficients are zero."""
    return {"effects.damping": {"kind": kind} | dict.fromkeys(keys, 0.0)}


SWITCHED_OFF: tuple[dict[str, Any], ...] = (
    {"effects.proximal_axial": 0},
    {"effects.distal_bending": 0},
    {"effects.quasi_static": []},
    {"effects.beam": "euler-bernoulli", "mechanism.material.poissons_ratio": 0.1},
    {"effects.foreshortening": False},
    {"effects.gravity": [0.0, 0.0]},
    {"payload.mass": 0.0},
    {"payload.inertia": 0.0},
    stands_still("modal", "ratio"),
    stands_still("stiffness", "time"),
    stands_still("mass", "rate"),
    stands_still("rayleigh", "rate", "time"),
    {"effects.motor_inertia": 0.0},
    {"effects.joint_friction": {"viscous": 0.0, "coulomb": 0.0}},
    {"effects.joint_friction": {"kind": "stiction"}},
)


@pytest.mark.parametrize("off", SWITCHED_OFF)
def test_an_effect_that_is_switched_off_costs_nothing(off: dict[str, Any]) -> None:
    """Not a state, not a parameter, not a letter of C remains of it."""
    model = build_model(load_scene("barnard2012-6kg").replace(BARE | off))
    assert generate_functions(model) == generate_functions(bare())
    assert (model.unknowns, model.parameters) == (bare().unknowns, bare().parameters)


@pytest.mark.parametrize("drive", ["motion", "torque"])
def test_a_robot_without_elasticity_has_no_elastic_state(drive: str) -> None:
    """Rigid links leave the motors' angles alone, and less than half of the operations."""
    changes = {"effects.proximal_bending": 0, "effects.distal_axial": 0, "cosimulation.drive": drive}
    rigid = build_model(load_scene("barnard2012-6kg").replace(BARE | changes))
    assert rigid.degrees_of_freedom == (2 if drive == "torque" else 0)
    assert not any("bending" in variable.name or "axial" in variable.name for variable in rigid.outputs)
    operations = [model.functions["residual"].n_instructions() for model in (rigid, bare(drive))]
    assert operations[0] < 0.5 * operations[1]


def test_the_papers_model_stays_small() -> None:
    """Effects that a scene leaves out don't creep into its equations: 953 operations for the paper's 12 coordinates."""
    model = build_model(load_scene("barnard2012-6kg"))
    assert model.functions["residual"].n_instructions() <= 953
    assert model.functions["mass_matrix"].n_instructions() <= 1195
    assert model.functions["outputs"].n_instructions() <= 747


def test_every_effect_is_registered() -> None:
    """A class that `EFFECTS` doesn't name would be left out of every model without a word."""
    modules = [path.stem for path in (Path(__file__).parents[2] / "model").glob("*.py")]
    classes = [each for name in modules for each in vars(import_module(f"flexfmu.model.{name}")).values()]
    kinds = {each for each in classes if inspect.isclass(each) and issubclass(each, Effect)}
    assert {each for each in kinds if not inspect.isabstract(each)} == set(effect_classes())

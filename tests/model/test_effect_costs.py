"""What each effect costs in states, parameters, operations and bytes of C, and that it costs nothing where it isn't chosen."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from flexfmu.fmu_build.codegen import generate_functions
from flexfmu.model.effects import Effect as Base
from flexfmu.model.five_bar import effect_classes
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicModel


@dataclass(frozen=True)
class Cost:
    """Size of a model: states, names of parameters, operations of residual, of outputs and of all functions, bytes of C."""

    states: int
    parameters: frozenset[str]
    residual: int
    outputs: int
    operations: int
    code: int


def cost(model: SymbolicModel) -> Cost:
    files, _ = generate_functions(model)
    return Cost(
        states=2 * model.degrees_of_freedom,
        parameters=frozenset(variable.name for variable in model.parameters),
        residual=model.functions["residual"].n_instructions(),
        outputs=model.functions["outputs"].n_instructions(),
        operations=sum(function.n_instructions() for function in model.functions.values()),
        code=sum(len(text.encode()) for text in files.values()),
    )


BARE = {
    "payload.mass": 0.0,
    "effects": {"gravity": [0.0, 0.0], "basis": "craig-bampton", "proximal_bending": 1, "distal_axial": 1},
}


@lru_cache
def bare(drive: str) -> Scene:
    return load_scene("barnard2012-6kg").replace(BARE | {"cosimulation.drive": drive})


@lru_cache
def bare_cost(drive: str) -> Cost:
    return cost(build_model(bare(drive)))


@dataclass(frozen=True)
class Effect:
    """An effect's keys when it is in, when it is out, and what it adds: parameters and states."""

    on: dict[str, Any]
    off: dict[str, Any]
    parameters: frozenset[str] = frozenset()
    states: int = 0


def switched(key: str, on: Any, off: Any, *parameters: str) -> Effect:
    """An effect of one key, which adds parameters."""
    return Effect({key: on}, {key: off}, frozenset(parameters))


def damping(*parameters: str, **keys: Any) -> Effect:
    """A damping, with its coefficients or with zeros."""
    none = {key: value if key == "kind" else 0.0 for key, value in keys.items()}
    return switched("effects.damping", keys, none, *parameters)


THICK = {"effects.beam": "euler-bernoulli", "mechanism.material.poissons_ratio": 0.1}
ELASTIC = {"effects.transmission": {"stiffness": 1e4}, "effects.motor_inertia": 0.1}
STATIC = {"effects.proximal_axial": 1, "effects.quasi_static": ["proximal_axial"]}
FRICTION = {"viscous": 0.0, "coulomb": 0.0}
STICKING = {"kind": "stiction", "coulomb": 1.0}
EFFECTS = {
    "proximal bending": Effect({"effects.proximal_bending": 2}, {}, states=4),
    "proximal axial": Effect({"effects.proximal_axial": 1}, {"effects.proximal_axial": 0}, states=4),
    "distal bending": Effect({"effects.distal_bending": 1}, {"effects.distal_bending": 0}, states=4),
    "distal axial": Effect({"effects.distal_axial": 2}, {}, states=4),
    "static proximal axial": Effect(STATIC, {"effects.quasi_static": []}),
    "shear": Effect({"effects.beam": "timoshenko"}, THICK, frozenset({"material.poissons_ratio"})),
    "foreshortening": switched("effects.foreshortening", True, False),
    "gravity": switched("effects.gravity", [1.0, 2.0], [0.0, 0.0], "gravity.x", "gravity.y"),
    "point payload": switched("payload.mass", 1.0, 0.0, "payload.mass"),
    "payload that turns": switched("payload.inertia", 0.1, 0.0, "payload.inertia"),
    "modal damping": damping("damping.ratio", kind="modal", ratio=0.1),
    "stiffness-proportional damping": damping("damping.time", kind="stiffness", time=1e-4),
    "mass-proportional damping": damping("damping.rate", kind="mass", rate=1.0),
    "Rayleigh damping": damping("damping.rate", "damping.time", kind="rayleigh", rate=1.0, time=1e-4),
    "motor inertia": switched("effects.motor_inertia", 0.1, 0.0, "motor_inertia"),
    "friction": switched("effects.joint_friction", {"viscous": 0.1}, FRICTION, "joint_friction.viscous"),
    "friction that sticks": switched(
        "effects.joint_friction", STICKING, {"kind": "stiction"}, "joint_friction.coulomb", "joint_friction.breakaway"
    ),
    "elastic transmissions": Effect(ELASTIC, {}, frozenset({"transmission.stiffness", "motor_inertia"}), states=4),
}


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["motion", "torque"])
@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS.keys())
def test_an_effect_costs_what_it_is(effect: Effect, drive: str) -> None:
    """It adds its states, its parameters and operations, which the model without it doesn't have."""
    without, paid = bare_cost(drive), cost(build_model(bare(drive).replace(effect.on)))
    assert paid.states == without.states + effect.states
    assert paid.parameters == without.parameters | effect.parameters
    assert not without.parameters & effect.parameters
    assert paid.residual + paid.outputs > without.residual + without.outputs
    assert paid.operations > without.operations


SWITCHED_OFF = {name: effect.off for name, effect in EFFECTS.items() if effect.off}


@pytest.mark.parametrize("off", SWITCHED_OFF.values(), ids=SWITCHED_OFF.keys())
def test_an_effect_that_is_switched_off_costs_nothing(off: dict[str, Any]) -> None:
    """Not a state, not an operation, not a byte of C remains of it."""
    assert cost(build_model(bare("motion").replace(off))) == bare_cost("motion")


@pytest.mark.parametrize("drive", ["motion", "torque"])
def test_a_robot_without_elasticity_has_no_elastic_state(drive: str) -> None:
    """Rigid links leave the motors' angles alone, and less than half of the operations."""
    rigid = build_model(bare(drive).replace({"effects.proximal_bending": 0, "effects.distal_axial": 0}))
    assert rigid.degrees_of_freedom == (2 if drive == "torque" else 0)
    assert not any("bending" in variable.name or "axial" in variable.name for variable in rigid.outputs)
    assert rigid.functions["residual"].n_instructions() < 0.5 * bare_cost(drive).residual
    assert cost(rigid).code < bare_cost(drive).code


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
    kinds = {each for each in classes if inspect.isclass(each) and issubclass(each, Base)}
    assert {each for each in kinds if not inspect.isabstract(each)} == set(effect_classes())

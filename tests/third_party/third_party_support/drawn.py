"""Model descriptions of many scenes, without compiling any: what the static checkers read."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

from export_support.kinds import KINDS

from flexfmu.fmu_build.block_build import block_description, regular_block
from flexfmu.fmu_build.description import description_xml
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import plant_description
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

SHIPPED = ("barnard2012-6kg", "barnard2012-0.1kg")
DRAWN = 14
BLOCKS = ("pd", "pid", "computed-torque", "learning", "shaper", "delay", "encoder", "lag", "noise")

CHOICES: dict[str, tuple[Any, ...]] = {
    "cosimulation.drive": ("motion", "torque"),
    "cosimulation.initial": ("static", "undeformed"),
    "cosimulation.step": (1e-4, 1e-3),
    "payload.mass": (0.0, 0.1, 6.0),
    "effects.gravity": ([0.0, 0.0], [0.0, -9.81]),
    "effects.proximal_bending": (0, 1, 3),
    "effects.distal_axial": (0, 2),
    "effects.distal_bending": (0, 1),
    "effects.damping": (
        {"kind": "none"},
        {"kind": "modal", "ratio": 0.02},
        {"kind": "stiffness", "time": 1e-5},
        {"kind": "rayleigh", "time": 1e-5, "rate": 2.0},
    ),
    "effects.basis": ("assumed-modes", "craig-bampton"),
    "effects.beam": ("euler-bernoulli", "timoshenko"),
    "effects.foreshortening": (False, True, "exact"),
    "effects.reactions": (False, True),
    "effects.motor_inertia": (0.0, 0.1),
    "effects.joint_friction": (None, {"viscous": 0.5, "coulomb": 1.0}),
}
"""Keys of a scene and the values to draw from."""


def descriptions() -> dict[str, str]:
    """Name → text of modelDescription.xml."""
    plants = {scene.name: plant_description(build_model(scene)) for scene in scenes()}
    blocks = {name: block_description(regular_block(KINDS[name]())) for name in BLOCKS}
    rest = "{00112233-4455-6677-8899-aabbccddeeff}", DefaultExperiment(0.68, 2e-4, 1e-6), ("model.c",)
    return {name: description_xml(description, *rest) for name, description in (plants | blocks).items()}


def scenes() -> Iterator[Scene]:
    """The shipped scenes and drawn ones."""
    yield from map(load_scene, SHIPPED)
    random = Random(2012)
    base = load_scene(SHIPPED[0])
    for number in range(DRAWN):
        drawn = {key: random.choice(values) for key, values in CHOICES.items()}
        chosen = {key: value for key, value in drawn.items() if value is not None}
        yield base.replace({"name": f"drawn-{number}"} | chosen)

"""Model descriptions of many scenes, without compiling any: what the static checkers read."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

import blocks as made

from flexfmu.cosim.control.shapers import shaper_block
from flexfmu.fmu_build.block_build import block_description, regular_block
from flexfmu.fmu_build.description import Description, description_xml
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.sources import plant_description
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.shapers.sequence import ImpulseSequence

SHIPPED = ("barnard2012-6kg", "barnard2012-0.1kg")
DRAWN = 14
SAMPLE_TIME = 1e-3

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
    "effects.foreshortening": (False, True),
    "effects.reactions": (False, True),
    "effects.motor_inertia": (0.0, 0.1),
    "effects.joint_friction": (None, {"viscous": 0.5, "coulomb": 1.0}),
}
"""Keys of a scene and the values to draw from."""


def descriptions() -> dict[str, str]:
    """Name → text of modelDescription.xml."""
    plants = {scene.name: plant_description(build_model(scene)) for scene in scenes()}
    blocks_ = {name: block_description(regular_block(block)) for name, block in blocks().items()}
    return {name: _text(description) for name, description in (plants | blocks_).items()}


def scenes() -> Iterator[Scene]:
    """The shipped scenes and drawn ones."""
    yield from map(load_scene, SHIPPED)
    random = Random(2012)
    base = load_scene(SHIPPED[0])
    for number in range(DRAWN):
        drawn = {key: random.choice(values) for key, values in CHOICES.items()}
        chosen = {key: value for key, value in drawn.items() if value is not None}
        yield base.replace({"name": f"drawn-{number}"} | chosen)


def blocks() -> dict[str, SymbolicBlock]:
    """Controllers, a shaper and imperfections."""
    sequence = ImpulseSequence((0.0, 0.0081, 0.0163), (0.3, 0.45, 0.25))
    time: Any = {"sample_time": SAMPLE_TIME}
    start: Any = {"signal": "position", "initial": (0.4, -0.6)}
    return {
        "pd": made.pd((900.0, 800.0), 12.0, **time),
        "pid": made.pid(900.0, 4e4, 12.0, filter_time=3e-3, **time),
        "computed-torque": made.computed_torque(4e3, 90.0, **time),
        "learning": made.learning(gain=100.0, cycles=2, period=300 * SAMPLE_TIME, **time),
        "shaper": shaper_block(sequence, SAMPLE_TIME),
        "delay": made.delay(2.3 * SAMPLE_TIME, **start, **time),
        "encoder": made.encoder(4000, window=3, **time),
        "lag": made.lag(2e-3, **start, **time),
        "noise": made.noise([0.1, 0.2], seed=5, **time),
    }


def _text(description: Description) -> str:
    experiment = DefaultExperiment(stop_time=0.68, step=2e-4, tolerance=1e-6)
    return description_xml(description, "{00112233-4455-6677-8899-aabbccddeeff}", experiment, ("model.c",))

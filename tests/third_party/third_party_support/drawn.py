"""Model descriptions of many scenes, without compiling any: what the static checkers read."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random
from typing import Any

from flexfmu.cosim.control.controllers.computed_torque import computed_torque
from flexfmu.cosim.control.controllers.iterative_learning import iterative_learning
from flexfmu.cosim.control.controllers.pid import pd, pid
from flexfmu.cosim.control.imperfections.channels import joint_channels
from flexfmu.cosim.control.imperfections.delay import delay
from flexfmu.cosim.control.imperfections.lag import lag
from flexfmu.cosim.control.imperfections.signal_blocks import encoder, gaussian_noise
from flexfmu.cosim.control.shapers import shaper_block
from flexfmu.fmu_build.block_build import block_description, regular_block
from flexfmu.fmu_build.description import Description, description_xml
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.sources import plant_description
from flexfmu.model.numeric import inverse_dynamics
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
    positions = joint_channels("position", (0.4, -0.6))
    robot = inverse_dynamics(load_scene(SHIPPED[0]))
    return {
        "pd": pd((900.0, 800.0), 12.0, sample_time=SAMPLE_TIME),
        "pid": pid(900.0, 4e4, 12.0, sample_time=SAMPLE_TIME, filter_time=3e-3),
        "computed-torque": computed_torque(robot, 4e3, 90.0, sample_time=SAMPLE_TIME),
        "learning": iterative_learning(100.0, 300, sample_time=SAMPLE_TIME),
        "shaper": shaper_block(sequence, SAMPLE_TIME),
        "delay": delay(positions, 2.3 * SAMPLE_TIME, sample_time=SAMPLE_TIME),
        "encoder": encoder(4000, sample_time=SAMPLE_TIME, window=3),
        "lag": lag(positions, 2e-3, sample_time=SAMPLE_TIME),
        "noise": gaussian_noise(positions, [0.1, 0.2], 5, sample_time=SAMPLE_TIME),
    }


def _text(description: Description) -> str:
    experiment = DefaultExperiment(stop_time=0.68, step=2e-4, tolerance=1e-6)
    return description_xml(description, "{00112233-4455-6677-8899-aabbccddeeff}", experiment, ("model.c",))

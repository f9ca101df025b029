"""The scenes of `effect_choice.py`: a grid of two robots, three profiles, 0 to 10 kg, 0.2 to 1 s; and
scenes drawn at random, 0.15 to 3 s, with three kinds of damping. Not a script of its own."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flexfmu import load_scene
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.model.scene.schema import Scene

PAPER = load_scene("barnard2012-6kg")

ROBOTS: dict[str, dict[str, Any]] = {
    "paper": {},
    "tubes": {
        "mechanism.base_half_distance": 0.12,
        "mechanism.proximal": {"length": 0.28, "diameter": 0.030, "inner_diameter": 0.020},
        "mechanism.distal": {"length": 0.42, "diameter": 0.028, "inner_diameter": 0.018},
    },
}
PROFILES: dict[str, dict[str, Any]] = {
    "poly7": {"kind": "poly7"},
    "bang-bang": {"kind": "bang-bang"},
    "trapezoidal": {"kind": "trapezoidal", "ramp": 0.25},
}
TASKS = ((0.0, 0.20), (0.1, 0.30), (0.5, 0.60), (1.0, 0.20), (3.0, 0.30), (6.0, 0.43), (10.0, 0.25), (10.0, 1.00))
"""Payload [kg] and duration [s]."""


DAMPINGS: dict[str, dict[str, Any]] = {
    "modal": {"kind": "modal", "ratio": 0.1357},
    "stiffness": {"kind": "stiffness", "time": 1e-4},
    "none": {"kind": "none"},
}


@dataclass(frozen=True)
class Case:
    """One scene: names of robot and profile, payload [kg], duration [s] and name of the damping."""

    robot: str
    profile: str
    payload: float
    duration: float
    damping: str = "modal"

    def scene(self) -> Scene:
        """The paper's scene with this robot and task."""
        changes = {"trajectory.profile": PROFILES[self.profile], "trajectory.duration": self.duration}
        changes["effects.damping"] = DAMPINGS[self.damping]
        return PAPER.replace({**ROBOTS[self.robot], **changes, "payload.mass": self.payload})


GRID = tuple(Case(robot, profile, *task) for robot, profile, task in itertools.product(ROBOTS, PROFILES, TASKS))


def drawn(count: int, seed: int) -> tuple[Case, ...]:
    """Cases at random: one payload of six is none, the others and all durations are as often small as large."""
    dice = random.Random(seed)

    def between(low: float, high: float) -> float:
        return float(f"{low * math.exp(dice.random() * math.log(high / low)):.2g}")

    return tuple(
        Case(
            dice.choice(list(ROBOTS)),
            dice.choice(list(PROFILES)),
            between(0.05, 10.0) if dice.randrange(6) else 0.0,
            between(0.15, 3.0),
            dice.choice(list(DAMPINGS)),
        )
        for _ in range(count)
    )


def fmu_of(scene: Scene) -> Path:
    """The FMU of a robot and a set of effects, shared by all payloads and motions, which are parameters and inputs."""
    same = {"payload.mass": 1.0, "trajectory": PAPER.trajectory.model_dump(exclude_none=True), "effects.choice": None}
    return build_scene(scene.replace({**same, "cosimulation.tolerance": 1e-4})).path

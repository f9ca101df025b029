"""The scenes of `effect_choice.py`: a grid of two robots, three profiles, 0 to 10 kg, 0.2 to 1 s; and
scenes drawn at random, 0.15 to 3 s, also of steel, with four kinds of damping, alone, with a shaper or in a loop. Not a script of its own."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass
from typing import Any

from flexfmu import load_scene
from flexfmu.model.scene.schema import Scene

PAPER = load_scene("barnard2012-6kg")

ROBOTS: dict[str, dict[str, Any]] = {
    "paper": {},
    "tubes": {
        "mechanism.base_half_distance": 0.12,
        "mechanism.proximal": {"length": 0.28, "diameter": 0.030, "inner_diameter": 0.020},
        "mechanism.distal": {"length": 0.42, "diameter": 0.028, "inner_diameter": 0.018},
    },
    "steel": {"mechanism.material": {"density": 7850.0, "youngs_modulus": 210e9}},
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
    "1 %": {"kind": "modal", "ratio": 0.01},
}
_PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 5e-4}
_PID = {**_PD, "kind": "pid", "proportional": 3e3, "integral": 2e4, "derivative": 40.0}
_LOOP = {"cosimulation.drive": "torque", "cosimulation.step": 5e-4, "effects.motor_inertia": 0.1}
AROUND: dict[str, dict[str, Any]] = {
    "": {},
    "shaper": {"shaper": [{"kind": "zvd"}]},
    "PD": {**_LOOP, "controller": [_PD]},
    "PID": {
        **_LOOP,
        "controller": [_PID],
        "filter": [{"kind": "low-pass", "signal": "torque", "frequency": 800.0}],
        "disturbance": [{"kind": "step", "signal": "force.x", "amplitude": 20.0, "start": 0.05}],
    },
}
"""What is around the robot."""


@dataclass(frozen=True)
class Case:
    """One scene: names of robot and profile, payload [kg], duration [s], names of the damping and of what is around the robot."""

    robot: str
    profile: str
    payload: float
    duration: float
    damping: str = "modal"
    around: str = ""

    def scene(self) -> Scene:
        """The paper's scene with this robot and task."""
        changes = {"trajectory.profile": PROFILES[self.profile], "trajectory.duration": self.duration}
        changes["effects.damping"] = DAMPINGS[self.damping]
        return PAPER.replace({**ROBOTS[self.robot], **AROUND[self.around], **changes, "payload.mass": self.payload})


GRID = tuple(
    Case(robot, profile, *task) for robot, profile, task in itertools.product(("paper", "tubes"), PROFILES, TASKS)
)


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
            dice.choice(["", *AROUND]),
        )
        for _ in range(count)
    )

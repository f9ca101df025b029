"""One joint as a plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable


@dataclass
class Axis:
    """An inertia [kg.m2] that a held torque and a held disturbance turn, with a load [N.m] that pulls; exact over every step."""

    start: tuple[float, float] = (0.0, 0.0)
    load: float = 3.0
    inertia: float = 0.2

    name = "plant"
    variables = (
        SlaveVariable("joint1.position", "output"),
        SlaveVariable("joint1.velocity", "output"),
        SlaveVariable("joint1.torque", "input", start=0.0),
        SlaveVariable("joint1.disturbance", "input", start=0.0),
    )

    def __post_init__(self) -> None:
        self.feedthrough: Mapping[str, tuple[str, ...]] = {"joint1.position": (), "joint1.velocity": ()}

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.values = np.array([*self.start, 0.0, 0.0])

    def set(self, indices: Indices, values: RealArray) -> None:
        self.values[indices] = values

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.values[indices]

    def step(self, time: float, step: float) -> None:
        angle, rate, torque, disturbance = self.values
        self.values[:2] = self.moved(angle, rate, torque + disturbance, step)

    def moved(self, angle: float, rate: float, torque: float, step: float) -> tuple[float, float]:
        """Angle and rate after a step."""
        acceleration = (torque - self.load) / self.inertia
        return angle + step * rate + step**2 / 2.0 * acceleration, rate + step * acceleration

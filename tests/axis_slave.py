"""One joint as a plant."""

from __future__ import annotations

from collections.abc import Mapping

from python_slave import PythonSlave

from flexfmu.cosim.engine.slave import SlaveVariable


class Axis(PythonSlave):
    """An inertia [kg.m2] that a held torque and a held disturbance turn, with a load [N.m] that pulls; exact over every step."""

    name = "plant"
    variables = (
        SlaveVariable("joint1.position", "output"),
        SlaveVariable("joint1.velocity", "output"),
        SlaveVariable("joint1.torque", "input", start=0.0),
        SlaveVariable("joint1.disturbance", "input", start=0.0),
    )

    def __init__(self, start: tuple[float, float] = (0.0, 0.0), load: float = 3.0, inertia: float = 0.2) -> None:
        super().__init__()
        self.start, self.load, self.inertia = start, load, inertia
        self.feedthrough: Mapping[str, tuple[str, ...]] = {"joint1.position": (), "joint1.velocity": ()}

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.memory[:] = [*self.start, 0.0, 0.0]

    def step(self, time: float, step: float) -> None:
        angle, rate, torque, disturbance = self.memory
        self.memory[:2] = self.moved(angle, rate, torque + disturbance, step)

    def moved(self, angle: float, rate: float, torque: float, step: float) -> tuple[float, float]:
        """Angle and rate after a step."""
        acceleration = (torque - self.load) / self.inertia
        return angle + step * rate + step**2 / 2.0 * acceleration, rate + step * acceleration

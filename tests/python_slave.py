"""What slaves of tests do alike: a test writes only what its own slave does."""

from __future__ import annotations

import numpy as np

from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable


class PythonSlave:
    """A slave whose variables are the numbers in ``memory``; it does nothing of its own.

    Attributes:
        name, variables: as for `Slave`.
        memory: (n,) values of the variables, at first their starts or zero.
        time: reached [s].
    """

    name = "slave"
    variables: tuple[SlaveVariable, ...] = ()

    def __init__(self, name: str | None = None) -> None:
        self.name = self.name if name is None else name
        self.memory = np.array([each.start or 0.0 for each in self.variables])
        self.time = 0.0

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.time = start_time

    def set(self, indices: Indices, values: RealArray) -> None:
        self.memory[indices] = values

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.memory[indices]

    def step(self, time: float, step: float) -> None:
        self.time = time + step


class Block(PythonSlave):
    """Inputs u1 and u2 in metres, outputs y1 and y2; all with direct feedthrough unless the feedthrough says otherwise."""

    def __init__(self, name: str, unit: str = "m", **feedthrough: tuple[str, ...]) -> None:
        inputs = [SlaveVariable(f"u{i}", "input", "m", 0.0) for i in (1, 2)]
        self.variables = (*inputs, *(SlaveVariable(output, "output", unit) for output in ("y1", "y2")))
        self.feedthrough = feedthrough
        super().__init__(name)


class SampledSlave(PythonSlave):
    """A slave that must never be stepped."""

    def step(self, time: float, step: float) -> None:
        raise AssertionError("a sampled slave is never stepped")

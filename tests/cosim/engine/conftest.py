"""What several tests use: an FMU from elsewhere, compiled on the spot, and an oscillator split into two slaves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from foreign_fmu import maker

from flexfmu.cosim.engine.master.system import System, connect
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable


@pytest.fixture(scope="session")
def foreign_fmu(make_decay: Callable[..., Path]) -> Path:
    """A plain FMI 2.0 co-simulation FMU that knows nothing of ours."""
    return make_decay()


@pytest.fixture(scope="session")
def event_fmu(make_events: Callable[..., Path]) -> Path:
    """A plain FMI 3.0 co-simulation FMU with events, arrays and variables of all types."""
    return make_events()


@pytest.fixture(scope="session")
def make_events(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes the FMI 3.0 FMU with its description changed."""
    return maker(tmp_path_factory.mktemp("events"), "events", "events.xml", fmpy.platform_tuple)


@pytest.fixture(scope="session")
def make_task(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Makes a PID controller of another tool's kind with one fixed step, its description changed: make_task(("m", "mm"))."""
    return maker(tmp_path_factory.mktemp("task"), "task", "task.xml")


class Mass:
    """A unit mass on a spring of its own, coupled by another to the displacement that is its input.

    x'' = -stiffness x + coupling (u - x), solved exactly for a polynomial input. Outputs are x and v = x'; derivatives
    up to ``order`` are given and twice as many taken.
    """

    feedthrough = {"x": (), "v": ()}  # noqa: RUF012

    def __init__(self, name: str, start: float, order: int, stiffness: float, coupling: float) -> None:
        self.name, self.start, self.max_output_order = name, start, order
        self.max_input_order = 2 * order + 1 if order else 0
        self.variables = (
            SlaveVariable("x", "output", "m"),
            SlaveVariable("v", "output", "m/s"),
            SlaveVariable("u", "input", "m", 0.0),
        )
        # x, v, then the input with its derivatives: a linear system
        self.memory = np.zeros(2 + self.max_input_order + 1)
        self.matrix = np.eye(self.memory.size, k=1)
        self.matrix[1, :3] = -stiffness - coupling, 0.0, coupling
        self.saved = 0

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.memory[:2] = self.start, 0.0

    def set(self, indices: Indices, values: RealArray) -> None:
        self.memory[2:] = 0.0
        self.memory[2] = values[0]

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        self.memory[3 : len(derivatives) + 3] = derivatives[:, 0]

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.memory[indices]

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        found = self.memory
        for row in derivatives:
            found = self.matrix @ found
            row[:] = found[indices]

    def step(self, time: float, step: float) -> None:
        # the exponential's series, in parts of at most a radian: the last term is below 1e-23
        parts = int(np.sqrt(-self.matrix[1, 0]) * step) + 1
        for _ in range(parts):
            term = self.memory
            for k in range(1, 25):
                term = (step / parts / k) * (self.matrix @ term)
                self.memory = self.memory + term

    def save(self) -> object:
        self.saved += 1
        return self.memory.copy()

    def restore(self, state: object) -> None:
        assert isinstance(state, np.ndarray)
        self.memory[:] = state

    def release(self, state: object) -> None:
        self.saved -= 1


class SplitOscillator:
    """Two equal masses, the first displaced by 1 m, split at the spring between them.

    Args:
        order: derivatives that the slaves exchange.
        stiffness: of the springs that hold the masses [N/m].
        coupling: of the spring between them [N/m].
    """

    def __init__(self, order: int, stiffness: float = 4.0, coupling: float = 9.0) -> None:
        self.slaves = [Mass(name, start, order, stiffness, coupling) for name, start in (("left", 1.0), ("right", 0.0))]
        self.frequencies = np.sqrt([stiffness, stiffness + 2.0 * coupling])

    def system(self) -> System:
        """The slaves wired together."""
        return connect(self.slaves, [("left.x", "right.u"), ("right.x", "left.u")])

    def error(self, recording: Recording) -> float:
        """Largest error of both displacements [m], against the normal modes."""
        together, apart = (np.cos(frequency * recording.time) for frequency in self.frequencies)
        left, right = (recording[f"{name}.x"].values for name in ("left", "right"))
        return float(max(abs(left - (together + apart) / 2.0).max(), abs(right - (together - apart) / 2.0).max()))


@pytest.fixture
def split_oscillator() -> type[SplitOscillator]:
    """Makes split oscillators."""
    return SplitOscillator

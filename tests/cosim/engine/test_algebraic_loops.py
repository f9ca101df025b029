"""Algebraic loops, solved at every instant: closed forms, with sampled slaves in them too, and failures by name."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.master.iteration import Anderson, FixedPoint, LoopSolver
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import AlgebraicLoop, connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable


class Function(PythonSlave):
    """y = f(u, w), at every instant, and nothing else."""

    variables = (SlaveVariable("y", "output"), *(SlaveVariable(each, "input", start=0.0) for each in ("u", "w")))

    def __init__(self, name: str, function: Callable[[float, float], float]) -> None:
        super().__init__(name)
        self.function = function

    def get(self, indices: Indices, values: RealArray) -> None:
        values[0] = self.function(self.memory[1], self.memory[2])


class Clock(PythonSlave):
    """y = t."""

    name = "clock"
    feedthrough = {"y": ()}  # noqa: RUF012
    variables = (SlaveVariable("y", "output"),)
    max_output_order = 1

    def get(self, indices: Indices, values: RealArray) -> None:
        values[0] = self.time

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        derivatives[:] = 1.0


WIRES = [("a.y", "b.u"), ("b.y", "a.u"), ("clock.y", "a.w")]


@pytest.mark.parametrize(
    ("gain", "solver"),
    [
        (-0.5, FixedPoint()),
        (0.9, FixedPoint(rounds=400)),
        (-3.0, FixedPoint(relaxation=0.3)),
        (-0.5, Anderson()),
        (-50.0, Anderson()),
        (7.0, Anderson(depth=1)),
    ],
)
def test_a_linear_loop(gain: float, solver: LoopSolver) -> None:
    """a.y = gain b.y + t and b.y = a.y + 1 give a.y = (gain + t) / (1 - gain), at every instant, whatever the gain."""
    slaves = [Function("a", lambda u, w: gain * u + w), Function("b", lambda u, w: u + 1.0), Clock()]
    result = simulate(connect(slaves, WIRES, loops=solver), 1.0, 0.1)
    assert result.outcome is Outcome.COMPLETED, result.message
    time, expected = result.recording.time, (gain + result.recording.time) / (1.0 - gain)
    np.testing.assert_allclose(result.recording["a.y"].values, expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(result.recording["b.y"].values, expected + 1.0, rtol=1e-8, atol=1e-9)
    assert time.size == 11


def test_a_loop_of_many_signals() -> None:
    """Three slaves in two rings that share one: as many unknowns as needed to cut them, and the linear solution."""
    functions = [lambda u, w: 0.3 * u - 2.0 * w + 1.0, lambda u, w: 1.5 * u, lambda u, w: 0.7 * u]
    slaves = [Function(name, function) for name, function in zip("abc", functions, strict=True)]
    system = connect(slaves, [("b.y", "a.u"), ("c.y", "a.w"), ("a.y", "b.u"), ("a.y", "c.u")], loops=Anderson())
    loop = system.exchange_order[0]
    assert isinstance(loop, AlgebraicLoop)
    assert loop.unknowns == ((0, 0),)
    a = simulate(system, 1.0, 0.5).recording["a.y"].values
    np.testing.assert_allclose(a, 1.0 / (1.0 - 0.3 * 1.5 + 2.0 * 0.7), rtol=1e-9)


def test_a_nonlinear_loop() -> None:
    """y = cos y + t / 2 is solved by Newton's method too; a slave behind the loop sees the solution of the same instant."""
    slaves = [Function("after", lambda u, w: 2.0 * u), Function("a", lambda u, w: math.cos(u) + 0.5 * w), Clock()]
    system = connect(slaves, [("a.y", "a.u"), ("clock.y", "a.w"), ("a.y", "after.u")], loops=Anderson())
    result = simulate(system, 1.0, 0.25)
    y = np.full(5, 0.7)
    for _ in range(9):
        y -= (y - np.cos(y) - 0.5 * result.recording.time) / (1.0 + np.sin(y))
    np.testing.assert_allclose(result.recording["a.y"].values, y, rtol=1e-9)
    np.testing.assert_allclose(result.recording["after.y"].values, 2.0 * y, rtol=1e-9)


class Accumulator(PythonSlave):
    """At its samples: y = 2 (1 - u) + the sum of what it was fed before; counts them."""

    name, sample_time = "controller", 0.5
    variables = (SlaveVariable("y", "output"), SlaveVariable("u", "input", start=0.0))

    def __init__(self) -> None:
        super().__init__()
        self.memory = np.zeros(3)
        self.samples = 0

    def sample(self, time: float) -> None:
        self.memory[0] = 2.0 * (1.0 - self.memory[1]) + self.memory[2]
        self.memory[2] += self.memory[1]
        self.samples += 1


class Returning(Accumulator):
    """Can be repeated."""

    def save(self) -> object:
        return self.memory.copy()

    def restore(self, state: object) -> None:
        assert isinstance(state, np.ndarray)
        self.memory[:] = state


class TwoPhases(Accumulator):
    """Tells its output apart from moving on."""

    def output(self, time: float) -> None:
        self.memory[0] = 2.0 * (1.0 - self.memory[1]) + self.memory[2]

    def update(self, time: float) -> None:
        self.memory[2] += self.memory[1]
        self.samples += 1

    def sample(self, time: float) -> None:
        raise AssertionError("not asked for")


@pytest.mark.parametrize("kind", [Returning, TwoPhases])
def test_a_sampled_slave_in_a_loop(kind: type[Accumulator]) -> None:
    """A controller and a plant with direct feedthrough, u = 3 y: at each sample instant y = 2 (1 - 3 y) + s is solved,
    while the sum s moves on once, however many rounds it takes; between the samples the output is held."""
    controller = kind()
    wires = [("controller.y", "plant.u"), ("plant.y", "controller.u")]
    system = connect([controller, Function("plant", lambda u, w: 3.0 * u)], wires, loops=Anderson())
    result = simulate(system, 1.0, 0.25)
    assert result.outcome is Outcome.COMPLETED, result.message
    expected, total = [], 0.0
    for _ in range(3):
        expected.append((2.0 + total) / 7.0)
        total += 3.0 * expected[-1]
    times = result.recording.time
    last = np.append(np.diff(times) > 0.0, True)
    held = [expected[0], expected[0], expected[1], expected[1], expected[2]]
    np.testing.assert_allclose(result.recording["controller.y"].values[last], held, rtol=1e-9)
    np.testing.assert_allclose(result.recording["plant.y"].values[last], 3.0 * np.array(held), rtol=1e-9)


def test_a_loop_without_a_solution() -> None:
    """y = y + 1 has none: the run ends with the loop's name, what is left, and what one could try."""
    system = connect([Function("a", lambda u, w: u + 1.0)], [("a.y", "a.u")], loops=FixedPoint(rounds=7))
    result = simulate(system, 1.0, 0.1)
    assert result.outcome is Outcome.LOOP_NOT_SOLVED
    assert "the loop a.u -> a.y -> a.u isn't solved at 0 s: after 7 rounds a.y still differs by 1 " in result.message
    assert "FixedPoint(relaxation=0.5)" in result.message

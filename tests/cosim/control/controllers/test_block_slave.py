"""The slave of a discrete-time block: what it holds, keeps, refuses, and what a sample costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi
import numpy as np
import pytest
from blocks import pd
from python_slave import PythonSlave

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.fmu_build.errors import BuildError
from flexfmu.model.symbolic import SymbolicBlock, Variable

GAIN = Variable("gain", "1", "Gain", "parameter", 2.0, minimum=0.0, maximum=10.0)


def running_sum(sample_time: float = 0.1, offset: float = 0.0) -> SymbolicBlock:
    """sum_k+1 = sum_k + gain u; y = [sum, sum + u]."""

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        return casadi.vertcat(x, x + u), x + p * u

    return block(
        "sum",
        "Running sum",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=[Variable("u", "N.m", "Input", "input", 1.0)],
        outputs=[Variable("past", "N.m", "Sum so far", "output"), Variable("now", "N.m", "Sum with u", "output")],
        parameters=[GAIN],
        states=[3.0],
    )


def outputs(slave: BlockSlave) -> list[float]:
    """Current outputs."""
    indices = np.array([i for i, each in enumerate(slave.variables) if each.causality == "output"])
    values = np.empty(indices.size)
    slave.get(indices, values)
    return list(values)


class Clock(PythonSlave):
    """y = t."""

    name = "clock"
    variables = (SlaveVariable("y", "output"),)

    def get(self, indices: Indices, values: RealArray) -> None:
        values[0] = self.time


def test_feedthrough_is_read_off_the_equations() -> None:
    """The master opens loops at outputs that don't depend on the input at once, so the declaration must be exact."""
    assert BlockSlave(running_sum()).feedthrough == {"past": (), "now": ("u",)}


@pytest.mark.parametrize("compiled", [False, True])
def test_samples(compiled: bool) -> None:
    """Initialisation shows the start state without moving on; every sample moves on once, in two phases too."""
    slave = BlockSlave(running_sum(), compiled=compiled)
    slave.initialize(0.0, 1.0, None)
    assert outputs(slave) == [3.0, 4.0]
    slave.sample(0.0)
    assert outputs(slave) == [3.0, 4.0]
    slave.sample(0.1)
    assert outputs(slave) == [5.0, 6.0]
    slave.output(0.2)
    slave.output(0.2)
    assert outputs(slave) == [7.0, 8.0]
    slave.set(np.array([0]), np.array([2.0]))
    slave.update(0.2)
    assert outputs(slave) == [7.0, 8.0]
    slave.sample(0.3)
    assert outputs(slave) == [11.0, 13.0]


def test_save_and_restore() -> None:
    """Going back restores inputs, parameters, outputs and states, as often as wanted."""
    slave = BlockSlave(running_sum())
    slave.initialize(0.0, 1.0, None)
    slave.sample(0.0)
    state = slave.save()
    futures = []
    for _ in range(2):
        slave.restore(state)
        assert outputs(slave) == [3.0, 4.0]
        for value in (1.0, 2.0, 5.0):
            slave.sample(0.0)
            slave.set(np.array([0, 1]), np.array([value, value]))
        futures.append(outputs(slave))
    assert futures[0] == futures[1]
    with pytest.raises(InputError, match="not saved by this slave"):
        slave.restore(np.zeros(2))


def test_initialisation_begins_anew() -> None:
    """A second run gives what the first one gave, with the parameters that have been set and without the inputs that the master set
    last."""
    slave = BlockSlave(running_sum())
    slave.set(np.array([1]), np.array([4.0]))
    for _ in range(2):
        slave.initialize(0.0, 1.0, None)
        slave.sample(0.0)
        slave.sample(0.1)
        assert outputs(slave) == [7.0, 8.0]
        slave.set(np.array([0]), np.array([9.0]))
        slave.terminate()


def test_bound_transfers() -> None:
    """They read what `get` reads, whether variables are neighbours or not, and set the inputs they were bound to, and no parameters."""
    slave = BlockSlave(running_sum())
    slave.initialize(0.0, 1.0, None)
    for indices, expected in (([2, 3], [3.0, 4.0]), ([3, 0], [4.0, 1.0]), ([1], [2.0])):
        values = np.empty(len(indices))
        slave.bind_get(np.array(indices), values)()
        assert list(values) == expected
    slave = BlockSlave(pd(1.0, 1.0, sample_time=1e-3))
    count = len(slave.block.inputs)
    read, got = np.arange(count), np.empty(count)
    for places in (np.arange(2, 5), np.array([7, 1, 4])):
        values = np.random.default_rng(3).normal(size=3)
        slave.bind_set(places, values)()
        slave.get(read, got)
        np.testing.assert_array_equal(got[places], values)
    with pytest.raises(InputError, match="only inputs can be connected"):
        slave.bind_set(np.array([count]), np.empty(1))
    with pytest.raises(InputError, match=r"pd\.joint1\.torque is an output"):
        slave.set(np.array([len(slave.variables) - 2]), np.ones(1))
    with pytest.raises(InputError, match=r"gain must be at least 0\.0 N\.m/rad, got -0\.5"):
        slave.set(np.array([count]), np.array([-0.5]))


@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_sample_and_hold(offset: float) -> None:
    """Between its instants offset + k * sample_time the outputs are held; before the first they are as initialised."""
    slave = BlockSlave(running_sum(sample_time=0.2, offset=offset))
    result = simulate(connect([Clock(), slave], [("clock.y", "sum.u")]), stop=1.0, step=0.05)
    assert result.outcome is Outcome.COMPLETED, result.message
    time, now = result.recording.time, result.recording["sum.now"].values
    past = result.recording["sum.past"].values
    instants = offset + 0.2 * np.arange(5)
    sums = 3.0 + 2.0 * np.concatenate([[0.0], np.cumsum(instants)])
    for k, instant in enumerate(instants):
        held = (time > instant + 1e-9) & (time < instant + 0.2 - 1e-9)
        np.testing.assert_allclose(past[held], sums[k], rtol=0, atol=1e-12)
        np.testing.assert_allclose(now[held], sums[k] + instant, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(now[time < offset - 1e-9], 3.0)


@pytest.mark.parametrize(("change", "message"), [
    ({"sample_time": 0.0}, r"sample time of block 'sum' must be positive, got 0.0 s"),
    ({"sample_time": np.nan}, r"sample time of block 'sum' must be positive, got nan s"),
    ({"offset": -0.1}, r"offset of block 'sum' must be zero or positive, got -0.1 s"),
    ({"states": (np.inf,)}, r"start value 0 of the states of block 'sum' must be finite, got inf"),
    ({"states": (1.0, 2.0)}, r"'output' of block 'sum' must take \(x, u, p\) of sizes \(2, 1, 1\) and give 2 values"),
    ({"inputs": (Variable("now", "1", "Twice", "input", 0.0),)}, r"two variables are named 'now'"),
    ({"parameters": (replace(GAIN, start=-1.0),)}, r"gain must be at least 0.0 1, got -1.0"),
    ({"parameters": (replace(GAIN, start=11.0),)}, r"gain must be at most 10.0 1, got 11.0"),
    ({"parameters": (replace(GAIN, start=None),)}, r"gain must be a finite number in 1, got None"),
])  # fmt: skip
def test_blocks_that_contradict_themselves(change: dict[str, object], message: str) -> None:
    """A wrong block is refused with its name, the value and what would be right, before anything runs."""
    with pytest.raises((InputError, BuildError), match=message):
        BlockSlave(replace(running_sum(), **change))


def test_cost_of_a_sample(count_calls: Callable[..., int]) -> None:
    """At 4 kHz a controller must cost less than the plant: a sample is one call of the equations and no other."""
    slave = BlockSlave(pd(50.0, 3.0, sample_time=1e-3))
    slave.initialize(0.0, 1.0, None)
    assert count_calls(lambda: slave.sample(0.0)) <= 2


@pytest.mark.parametrize(("sizes", "pieces"), [((1, 2), (1, 2, 2)), ((5, 0), (5, 0)), ((2, 0, 3), (2, 0, 3))])
def test_split(sizes: tuple[int, ...], pieces: tuple[int, ...]) -> None:
    """Pieces of these sizes, empty ones too, the last as often as it fits."""
    found = split(casadi.SX.sym("v", 5), *sizes)
    assert tuple(piece.numel() for piece in found) == pieces

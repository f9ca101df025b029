"""Iterative learning: the error shrinks from cycle to cycle as the theory predicts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.iterative_learning import iterative_learning
from flexfmu.cosim.engine.errors import InputError
from flexfmu.fmu_build.block_codegen import sample_function

Array = NDArray[np.float64]

H = 1e-3
CYCLE = 40
POLE = 0.6
"""Plant y_k+1 = POLE y_k + GAIN w_k, set back to zero at the start of every cycle."""
GAIN = 0.8
REFERENCE = np.sin(np.linspace(0.0, np.pi, CYCLE)) ** 2


def learn(cycles: int, **options: Any) -> tuple[Array, Array]:
    """Errors and learned torques (cycles, CYCLE) with the plant set back between the cycles."""
    slave = BlockSlave(iterative_learning(cycle=CYCLE, sample_time=H, joints=("axis",), **options))
    torque = np.empty(1)
    slave.initialize(0.0, 1.0, None)
    errors, torques = np.empty((cycles, CYCLE)), np.empty((cycles, CYCLE))
    for j in range(cycles):
        y = 0.0
        for k in range(CYCLE):
            errors[j, k] = REFERENCE[k] - y
            slave.set(np.array([0, 1]), np.array([REFERENCE[k], y]))
            slave.sample((j * CYCLE + k) * H)
            slave.get(np.array([3]), torque)
            torques[j, k] = torque[0]
            y = POLE * y + GAIN * torque[0]
    return errors, torques


def lifted(gain: float, shift: int, forgetting: float, cycles: int) -> tuple[Array, Array]:
    """The same by matrices over a whole cycle."""
    impulse = np.concatenate([[0.0], GAIN * POLE ** np.arange(CYCLE - 1)])
    plant = toeplitz(impulse, np.zeros(CYCLE))
    ahead = np.eye(CYCLE, k=shift)
    w, errors, torques = np.zeros(CYCLE), [], []
    for _ in range(cycles):
        e = REFERENCE - plant @ w
        errors.append(e)
        torques.append(w)
        w = (1.0 - forgetting) * w + gain * ahead @ e
    return np.array(errors), np.array(torques)


@pytest.mark.parametrize(("gain", "shift", "forgetting"), [
    (0.5, 1, 0.0), (0.5, 1, 0.05), (0.9, 2, 0.1), (0.2, 0, 0.0), (0.3, CYCLE - 1, 0.0),
])  # fmt: skip
def test_learning_law(gain: float, shift: int, forgetting: float) -> None:
    """Torques and errors of ten cycles are those of the lifted equations, to rounding."""
    found = learn(10, gain=gain, shift=shift, forgetting=forgetting)
    wanted = lifted(gain, shift, forgetting, 10)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * abs(other).max())


def test_converges_at_the_predicted_rate() -> None:
    """The error of the first learned sample falls by |1 - gain g| in every cycle, that of all samples in the end too."""
    gain = 0.5
    rate = 1.0 - gain * GAIN
    errors, _ = learn(60, gain=gain, shift=1)
    first = errors[:20, 1]
    np.testing.assert_allclose(first[1:] / first[:-1], rate, rtol=1e-9)
    assert abs(errors[-1]).max() < 1e-8 * abs(errors[0]).max()


def test_diverges_beyond_the_limit() -> None:
    """With |1 - gain g| > 1 the first sample's error grows: the sign of the prediction is right as well."""
    errors, _ = learn(6, gain=3.0, shift=1)
    np.testing.assert_allclose(errors[1:, 1] / errors[:-1, 1], 1.0 - 3.0 * GAIN, rtol=1e-9)


def test_forgetting_leaves_an_error() -> None:
    """The fixed point with forgetting: the first learned sample keeps r f / (f + gain g)."""
    gain, forgetting = 0.5, 0.1
    errors, _ = learn(100, gain=gain, shift=1, forgetting=forgetting)
    wanted = REFERENCE[1] * forgetting / (forgetting + gain * GAIN)
    np.testing.assert_allclose(errors[-1, 1], wanted, rtol=1e-9)


def test_first_cycle_is_silent() -> None:
    """Nothing has been learned in the first cycle, so nothing is put out."""
    _, torques = learn(1, gain=0.5)
    np.testing.assert_array_equal(torques, 0.0)


def test_a_cycle_of_one_sample() -> None:
    """The shortest cycle is an integrator without feedthrough."""
    slave = BlockSlave(iterative_learning(0.5, 1, sample_time=H, shift=0, joints=("axis",)))
    slave.initialize(0.0, 1.0, None)
    slave.set(np.array([0]), np.array([1.0]))
    values = np.empty((4, 1))
    for k in range(4):
        slave.sample(k * H)
        slave.get(np.array([3]), values[k])
    np.testing.assert_allclose(values[:, 0], [0.0, 0.5, 1.0, 1.5])
    assert slave.feedthrough == {"axis.feedforward": ()}


def test_joints_learn_apart() -> None:
    """Each joint has its own gain and table; one's error doesn't reach the other."""
    slave = BlockSlave(iterative_learning([1.0, 2.0], 3, sample_time=H, shift=0, learn_from="velocity"))
    slave.initialize(0.0, 1.0, None)
    output = np.empty(2)
    for k in range(4):
        slave.set(np.array([0, 1]), np.array([1.0, 10.0]) if k == 0 else np.zeros(2))
        slave.sample(k * H)
        slave.get(np.array([6, 7]), output)
        np.testing.assert_array_equal(output, [1.0, 20.0] if k == 3 else [0.0, 0.0])
    assert [variable.unit for variable in slave.block.parameters] == ["N.m.s/rad"] * 2


def test_long_tables_are_cheap() -> None:
    """A table of a whole motion at 4 kHz moves on as one block of memory, not number by number."""
    short, long = (sample_function(iterative_learning(1.0, cycle, sample_time=2.5e-4)) for cycle in (100, 2720))
    assert long.n_instructions() == short.n_instructions() < 100


@pytest.mark.parametrize(("change", "message"), [
    ({"cycle": 0}, "a cycle must have 1 to 1000000 samples, got 0"),
    ({"cycle": 2.5}, "a cycle must have 1 to 1000000 samples, got 2.5"),
    ({"shift": -1}, "the shift must be 0 to 9 samples, less than a cycle, got -1"),
    ({"shift": 10}, "the shift must be 0 to 9 samples, less than a cycle, got 10"),
    ({"forgetting": 1.0}, "the forgetting must be at least 0 and below 1, got 1.0"),
    ({"forgetting": np.nan}, "the forgetting must be at least 0 and below 1, got nan"),
    ({"gain": -1.0}, "learning_gain of joint1 must be at least 0.0 N.m/rad, got -1.0"),
    ({"gain": [1.0, np.inf]}, "learning_gain of joint2 must be finite"),
    ({"sample_time": 0.0}, "the sample time must be positive"),
])  # fmt: skip
def test_refused(change: dict[str, Any], message: str) -> None:
    """Lengths that don't fit and gains that can't work are refused."""
    with pytest.raises(InputError, match=message):
        iterative_learning(**({"gain": 1.0, "cycle": 10, "sample_time": H} | change))

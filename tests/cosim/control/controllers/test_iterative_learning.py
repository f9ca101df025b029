"""Iterative learning: the error shrinks from cycle to cycle as the theory predicts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blocks import learning, sampled
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.signal import butter, freqz

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers import iterative_learning
from flexfmu.cosim.control.controllers import iterative_learning as iterative_learnings
from flexfmu.cosim.engine.errors import InputError
from flexfmu.fmu_build.block_build import sample_function
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]

H = 1e-3
CYCLE = 40
POLE = 0.6
"""Plant y_k+1 = POLE y_k + GAIN w_k, set back to zero at the start of every cycle."""
GAIN = 0.8
REFERENCE = np.sin(np.linspace(0.0, np.pi, CYCLE)) ** 2


def learn(cycles: int, **options: Any) -> tuple[Array, Array]:
    """Errors and learned torques (cycles, CYCLE) with the plant set back between the cycles."""
    slave = BlockSlave(learning(cycles=2, period=CYCLE * H, sample_time=H, **options))
    torque = np.empty(1)
    slave.initialize(0.0, 1.0, None)
    errors, torques = np.empty((cycles, CYCLE)), np.empty((cycles, CYCLE))
    for j in range(cycles):
        y = 0.0
        for k in range(CYCLE):
            errors[j, k] = REFERENCE[k] - y
            slave.set(np.array([0, 2]), np.array([REFERENCE[k], y]))
            slave.sample((j * CYCLE + k) * H)
            slave.get(np.array([6]), torque)
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
    found = learn(10, gain=gain, lead=shift, forgetting=forgetting)
    wanted = lifted(gain, shift, forgetting, 10)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * abs(other).max())


def test_a_cycle_of_one_sample() -> None:
    """The shortest cycle is an integrator without feedthrough."""
    block = learning(gain=0.5, cycles=2, period=H, sample_time=H, lead=0)
    found = answer(block, np.ones((4, 1)))
    np.testing.assert_allclose(found[:, 0], [0.0, 0.5, 1.0, 1.5])
    assert block.feedthrough == {"joint1.feedforward": (), "joint2.feedforward": ()}


def test_long_tables_are_cheap() -> None:
    """A table of a whole motion at 4 kHz moves on as one block of memory, not number by number."""
    short, long = (
        sample_function(learning(gain=1.0, cycles=2, period=2.5e-4 * cycle, sample_time=2.5e-4))
        for cycle in (100, 2720)
    )
    assert long.n_instructions() == short.n_instructions() < 100


def by_weights(law: iterative_learnings.LearningLaw, errors: Array, gain: Array, places: Array) -> Array:
    """Learned torques (samples, n) for given errors (samples, n): the sums over weights, sample by sample."""
    cycle, (count, n) = len(places), errors.shape
    w, m = np.zeros((count + cycle, n)), law.behind
    ahead = max(law.ahead, m)
    for k in range(-ahead, count - ahead):
        at = np.clip(1.0 - abs(places[k % cycle] * (len(law.error) - 1) - np.arange(len(law.error))), 0.0, 1.0)
        kernel = np.tensordot(at, law.error, 1)
        torque = sum((law.torque[i + m] * w[k + i] for i in range(-m, m + 1) if k + i >= 0), start=np.zeros(n))
        for v, weights in enumerate(kernel):
            if (i := k + law.ahead - len(kernel) + 1 + v) >= 0:
                torque = torque + gain * (weights @ errors[i])
        if k + cycle >= 0:
            w[k + cycle] = torque
    return w[:count]


def answer(model: SymbolicBlock, errors: Array) -> Array:
    """Learned torques (samples, n) of a block for given errors (samples, n)."""
    return sampled(model, np.pad(errors, ((0, 0), (0, len(model.inputs) - errors.shape[1]))))


@pytest.mark.parametrize(("shift", "q_filter"), [(0, 200.0), (3, 120.0), (1, 90.0)])
def test_q_filter_in_the_block(shift: int, q_filter: float) -> None:
    """Samples that learn one after the other, from the torques of a cycle ago, give the weighted sums over the whole cycle."""
    cycle, gain = 60, np.array([0.3, 0.7])
    errors = np.random.default_rng(shift).normal(size=(4 * cycle, 2))
    options = {"lead": shift, "forgetting": 0.1, "q_filter": q_filter}
    found = answer(learning(gain=gain, cycles=2, period=cycle * H, sample_time=H, **options), errors)
    law = iterative_learnings.proportional_law(shift, 0.1, iterative_learnings.zero_phase(q_filter, H, cycle), 2)
    np.testing.assert_allclose(
        found, by_weights(law, errors, gain, np.zeros(cycle)), rtol=0, atol=1e-12 * abs(found).max()
    )


def test_norm_optimal_block(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights that change along the path, of both joints' errors, give the same sums."""
    rng, cycle = np.random.default_rng(1), 80
    decay = 0.7 ** np.arange(30)[:, np.newaxis, np.newaxis]
    response = decay * (np.eye(2) + 0.2 * rng.normal(size=(3, 1, 2, 2)))
    places = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(cycle) / cycle)
    errors = rng.normal(size=(3 * cycle, 2))
    monkeypatch.setattr(iterative_learning, "places_of", lambda context, instants: places)
    options = {"period": cycle * H, "sample_time": H, "forgetting": 0.05, "q_filter": 150.0}
    model = learning(law="norm-optimal", response=response.tolist(), cycles=2, **options)
    found = answer(model, errors)
    law = iterative_learnings.norm_optimal_law(response, 1e-3, 0.05, iterative_learnings.zero_phase(150.0, H, 39), 39)
    assert law.error.shape[0] == 3
    np.testing.assert_allclose(
        found, by_weights(law, errors, np.ones(2), places), rtol=0, atol=1e-12 * abs(found).max()
    )


@pytest.mark.parametrize("cut_off", [15.0, 60.0, 240.0, 480.0])
def test_q_filter_is_a_butterworth_filter_without_phase(cut_off: float) -> None:
    """Symmetric weights; the gain is that of SciPy's filter, forward and backward: 1/2 at the cut-off."""
    taps = iterative_learnings.zero_phase(cut_off, H, 500)
    np.testing.assert_allclose(taps, taps[::-1], rtol=0, atol=1e-15)
    frequency = np.array([1e-3, 0.3 * cut_off, cut_off, 0.5 * (cut_off + 0.5 / H)])
    i = np.arange(len(taps)) - len(taps) // 2
    found = np.exp(2j * np.pi * H * np.outer(frequency, i)) @ taps
    response = freqz(*butter(2, cut_off, fs=1.0 / H), worN=frequency, fs=1.0 / H)[1]
    np.testing.assert_allclose(found, abs(response) ** 2, atol=5e-3)
    assert found[2].real == pytest.approx(0.5, abs=5e-3)


def test_contraction_bounds_what_errors_do() -> None:
    """Over drawn gains, shifts, filters and plants: changes from cycle to cycle shrink by at most the contraction, and by nearly it."""
    rng = np.random.default_rng(7)
    tight = []
    for _ in range(40):
        pole, strength = rng.uniform(-0.3, 0.8), rng.uniform(0.2, 1.0)
        gain, shift, forgetting = rng.uniform(0.1, 1.2), int(rng.integers(1, 4)), rng.choice([0.0, 0.1])
        q = iterative_learnings.zero_phase(rng.choice([None, 100.0, 250.0]), H, 100)
        law = iterative_learnings.proportional_law(shift, forgetting, q, 1)
        impulse = np.concatenate([[0.0], strength * pole ** np.arange(200.0)])
        kept, learned, _ = law.effects(impulse[:, np.newaxis, np.newaxis], 0.0, np.array([gain]), H)
        contraction = abs(kept - learned[:, 0, 0]).max()
        # what becomes of torques that are short against the cycle: convolutions, without its ends
        size = 4096
        change = np.zeros(size)
        change[size // 2 : size // 2 + 20] = rng.normal(size=20)
        weights = np.roll(np.pad(law.torque, (0, size - len(law.torque))), -law.behind)
        errors = np.roll(
            np.pad(gain * law.error[0, :, 0, 0], (0, size - law.error.shape[1])), law.ahead - law.error.shape[1] + 1
        )
        one, other, plant = (np.fft.rfft(each) for each in (weights, errors, np.pad(impulse, (0, size - len(impulse)))))
        step = one.conj() - plant * other.conj()
        sizes = []
        for _ in range(60):
            sizes.append(np.linalg.norm(change))
            change = np.fft.irfft(step * np.fft.rfft(change), size)
        ratios = np.array(sizes[1:]) / sizes[:-1]
        assert (ratios <= contraction * (1.0 + 1e-3)).all()
        tight.append(ratios[-1] / contraction)
    assert min(tight) > 0.9


@pytest.mark.parametrize(("change", "message"), [
    ({"q_filter": 500.0}, "cut-off must be below half the sampling frequency of 1000 Hz, got 500 Hz"),
    ({"q_filter": 20.0}, "needs [0-9]+ samples before and after each, and a cycle leaves 4"),
    ({"period": 0.0}, "a cycle must have 1 to 1000000 samples, got 0"),
    ({"period": 10.5 * H}, "isn't a whole number of samples"),
    ({"period": None}, "learning needs a motion that is repeated"),
    ({"lead": 10}, "the lead must be 0 to 9 samples, less than a cycle, got 10"),
    ({"q_filter": "auto"}, "leaves the cut-off of the Q-filter open"),
])  # fmt: skip
def test_refused(change: dict[str, Any], message: str) -> None:
    """Lengths that don't fit the cycle, and what is still open, are refused."""
    with pytest.raises(InputError, match=message):
        learning(**({"gain": 1.0, "cycles": 2, "period": 10 * H, "sample_time": H} | change))

"""Noise: its law, its statistics, and that every signal has noise of its own that can be had again."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from blocks import noise, sampled

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.imperfections.signal_blocks import JUMP, MODULI, MULTIPLIERS, start_states
from flexfmu.cosim.engine.errors import InputError

H = 2.5e-4


def uniform_numbers(name: str, seed: int, count: int) -> np.ndarray:
    """The stream in whole-number NumPy."""
    s = [pow(a, JUMP * seed, m) * s % m for a, m, s in zip(MULTIPLIERS, MODULI, start_states(name), strict=True)]
    numbers = []
    for _ in range(count):
        s = [a * each % m for a, each, m in zip(MULTIPLIERS, s, MODULI, strict=True)]
        numbers.append((s[0] - s[1] - 1) % (MODULI[0] - 1) + 1)
    return np.array(numbers) / MODULI[0]


def test_gaussian_law() -> None:
    """y = u + sigma sqrt(-2 ln U) cos(2 pi V) with the streams' numbers in pairs, in plain NumPy."""
    u = np.random.default_rng(1).normal(size=(500, 2))
    y = sampled(noise([0.1, 0.2], seed=99, sample_time=H), u)
    for i, scale in enumerate((0.1, 0.2)):
        radius, angle = uniform_numbers(f"noise/joint{i + 1}.position", 99, 1000).reshape(-1, 2).T
        expected = u[:, i] + scale * np.sqrt(-2 * np.log(radius)) * np.cos(2 * pi * angle)
        np.testing.assert_allclose(y[:, i], expected, rtol=0, atol=2e-15)


def test_uniform_law() -> None:
    """y = u + half_width (2 U - 1), in plain NumPy."""
    y = sampled(noise(half_width=0.25, seed=4, signal="torque", sample_time=H, name="ripple"), np.full(500, 3.0))[:, 0]
    np.testing.assert_allclose(
        y, 3.0 + 0.25 * (2 * uniform_numbers("ripple/joint1.torque", 4, 500) - 1), rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("key", ["standard_deviation", "half_width"])
def test_seed_is_a_parameter(key: str) -> None:
    """The same seed gives the same noise, another one another; an importer can choose it."""
    silence = np.zeros((50, 2))
    first, other = (sampled(noise(**{key: 1.0}, seed=seed, sample_time=H), silence) for seed in (1, 2))
    again = noise(**{key: 1.0}, seed=1, sample_time=H)
    np.testing.assert_array_equal(sampled(again, silence), first)
    np.testing.assert_array_equal(sampled(again, silence, {"seed": 2.0}), other)
    assert not np.isin(first, other).any()


def test_seeds_out_of_range_are_refused_at_run_time() -> None:
    """A parameter set later is checked like an argument."""
    slave = BlockSlave(noise(1.0, seed=3, sample_time=H))
    with pytest.raises(InputError, match=r"seed must be at most 1048575.0 1, got 2000000.0"):
        slave.set(np.array([4]), np.array([2e6]))

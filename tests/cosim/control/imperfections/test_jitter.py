"""Sample jitter on signals whose value tells the time."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from blocks import jitter, sampled
from scipy.stats import kstest

H = 1e-3
SIX_SIGMA = 6.0


def delays(count: int, **options: Any) -> np.ndarray:
    """Delays of a ramp's samples [s]."""
    t = H * np.arange(count)
    block = jitter(4e-4, options.pop("seed", 1), sample_time=H, initial=(-H, -H), **options)
    return t - sampled(block, t)[:, 0]


def test_delays_are_uniform() -> None:
    """A signal that is the time itself shows the delays: uniform from zero to the largest, white."""
    late = delays(50_000)
    assert kstest(late, "uniform", args=(0.0, 4e-4)).pvalue > 1e-6
    assert abs(late.mean() - 2e-4) < SIX_SIGMA * 4e-4 / sqrt(12 * 50_000)
    assert abs(np.corrcoef(late[1:], late[:-1])[0, 1]) < SIX_SIGMA / sqrt(50_000)


def test_law() -> None:
    """Each output lies between this sample and the last one, at the place that the ramp's delay tells."""
    part = delays(400)[:, None] / H
    u = np.random.default_rng(1).normal(size=(400, 2))
    y = sampled(jitter(4e-4, 1, sample_time=H, initial=(0.5, -0.5)), u)
    last = np.vstack([[0.5, -0.5], u[:-1]])
    np.testing.assert_allclose(y, u - part * (u - last), rtol=0, atol=1e-12)


def test_channels_of_a_block_share_the_clock_and_blocks_do_not() -> None:
    """One converter samples all its channels at the same instant; another name or seed is another clock."""
    t = np.tile(H * np.arange(300)[:, None], 2)
    y = sampled(jitter(4e-4, 1, sample_time=H), t)
    np.testing.assert_array_equal(y[:, 0], y[:, 1])
    assert abs(np.corrcoef(delays(300), delays(300, name="other"))[0, 1]) < SIX_SIGMA / sqrt(300)
    assert abs(np.corrcoef(delays(300), delays(300, seed=2))[0, 1]) < SIX_SIGMA / sqrt(300)

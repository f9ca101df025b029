"""Quantisation and encoders: bounds, statistics, and the law in NumPy."""

from __future__ import annotations

from math import pi, sqrt
from typing import Any

import numpy as np
import pytest
from blocks import encoder, quantisation
from hypothesis import given, settings
from hypothesis import strategies as st

H = 1e-3
SIX_SIGMA = 6.0


@settings(max_examples=100)
@given(signal=st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=20), resolution=st.floats(1e-6, 1.0))
def test_error_bound(run: Any, signal: list[float], resolution: float) -> None:
    """The output is a whole multiple of the resolution, at most half of it away, as NumPy's floor has it."""
    u = np.array(signal)
    y = run(quantisation(resolution, sample_time=H), u)[:, 0]
    np.testing.assert_array_equal(y, resolution * np.floor(u / resolution + 0.5))
    assert (np.abs(y - u) <= resolution / 2 * (1 + 1e-9) + 1e-15).all()


def test_decision_levels(run: Any) -> None:
    """The output changes half-way between its levels, the upper level at the half-way point itself."""
    u = np.array([-1.5, -0.5 - 1e-9, -0.5, 0.5 - 1e-9, 0.5, 1.5 - 1e-9, 1.5])
    y = run(quantisation(1.0, sample_time=H), u)[:, 0]
    np.testing.assert_array_equal(y, [-1.0, -1.0, 0.0, 0.0, 1.0, 1.0, 2.0])


def test_quantisation_is_idempotent_for_binary_fractions(run: Any) -> None:
    """What is on the grid stays there."""
    block = quantisation(2.0**-10, sample_time=H)
    y = run(block, np.random.default_rng(1).normal(size=200))
    np.testing.assert_array_equal(run(block, y), y)


def test_variance_of_the_error(run: Any) -> None:
    """For a busy signal the error is uniform and white: mean 0, variance q² / 12."""
    q, count = 1e-3, 50_000
    u = np.random.default_rng(2).normal(scale=1.0, size=count)
    error = (run(quantisation(q, sample_time=H), u)[:, 0] - u) / q
    assert abs(error.mean()) < SIX_SIGMA * sqrt(1 / 12 / count)
    assert abs(error.var() - 1 / 12) < SIX_SIGMA * sqrt(1 / 180 / count)
    assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < SIX_SIGMA / sqrt(count)
    assert abs(np.corrcoef(error, u)[0, 1]) < SIX_SIGMA / sqrt(count)


def test_zero_resolution_switches_it_off(run: Any) -> None:
    """A perfect sensor is a value of the parameter, with a finite result."""
    u = np.random.default_rng(3).normal(size=(30, 2))
    block = quantisation(1e-2, sample_time=H)
    y = run(block, u, {"joint2.position.resolution": 0.0})
    np.testing.assert_array_equal(y[:, 1], u[:, 1])
    assert (y[:, 0] != u[:, 0]).all()


@settings(max_examples=40)
@given(counts=st.floats(1.0, 1e6), window=st.integers(1, 6), seed=st.integers(0, 99))
def test_encoder_law(run: Any, counts: float, window: int, seed: int) -> None:
    """Counts, angle and difference quotient as in plain NumPy, for any window."""
    u = np.random.default_rng(seed).normal(size=(25, 2))
    y = run(encoder(counts, sample_time=H, window=window), u)
    q = 2 * pi / counts
    c = np.floor(u / q + 0.5)
    past = np.vstack([np.tile(c[0], (window, 1)), c])[:25]
    np.testing.assert_array_equal(y[:, :2], q * c)
    np.testing.assert_allclose(y[:, 2:], (c - past) * q / (window * H), rtol=1e-14, atol=0)


@pytest.mark.parametrize("window", [1, 4])
def test_rate_comes_in_steps_and_late(run: Any, window: int) -> None:
    """The rate of a uniformly accelerated joint: steps of q / (w h), half the window late, at most one step off."""
    counts, t = 40_000, H * np.arange(2000)
    q = 2 * pi / counts
    velocity = run(encoder(counts, sample_time=H, window=window), 0.5 * 3.0 * t**2)[:, 2]
    step = q / (window * H)
    np.testing.assert_allclose(velocity / step, np.round(velocity / step), rtol=0, atol=1e-9)
    late = 3.0 * (t - window * H / 2)
    assert np.abs(velocity - late)[window:].max() <= step * (1 + 1e-9)


def test_encoder_variables_fit_a_controller() -> None:
    """Angle and rate have the names and units that joint controllers measure."""
    block = encoder(40_000, sample_time=H)
    assert [(each.name, each.unit) for each in block.outputs] == [
        ("joint1.position", "rad"),
        ("joint2.position", "rad"),
        ("joint1.velocity", "rad/s"),
        ("joint2.velocity", "rad/s"),
    ]
    assert [(each.name, each.start, each.tunable) for each in block.parameters] == [
        ("joint1.position.counts_per_turn", 40_000.0, True),
        ("joint2.position.counts_per_turn", 40_000.0, True),
    ]


def test_encoder_starts_at_standstill(run: Any) -> None:
    """At any angle the first rates are zero: no kick at the start."""
    y = run(encoder(10_000, sample_time=H, window=3), np.tile([0.7, 2.4], (5, 1)))
    np.testing.assert_array_equal(y[:, 2:], 0.0)

"""Quantisation and encoders: bounds, statistics, and the law in NumPy."""

from __future__ import annotations

from math import pi

import numpy as np
from blocks import encoder, quantisation, sampled
from hypothesis import given, settings
from hypothesis import strategies as st

H = 1e-3


def test_zero_resolution_switches_it_off() -> None:
    """A perfect sensor is a value of the parameter, with a finite result."""
    u = np.random.default_rng(3).normal(size=(30, 2))
    block = quantisation(1e-2, sample_time=H)
    y = sampled(block, u, {"joint2.position.resolution": 0.0})
    np.testing.assert_array_equal(y[:, 1], u[:, 1])
    assert (y[:, 0] != u[:, 0]).all()


@settings(max_examples=40)
@given(counts=st.floats(1.0, 1e6), window=st.integers(1, 6), seed=st.integers(0, 99))
def test_encoder_law(counts: float, window: int, seed: int) -> None:
    """Counts, angle and difference quotient as in plain NumPy, for any window."""
    u = np.random.default_rng(seed).normal(size=(25, 2))
    y = sampled(encoder(counts, sample_time=H, window=window), u)
    q = 2 * pi / counts
    c = np.floor(u / q + 0.5)
    past = np.vstack([np.tile(c[0], (window, 1)), c])[:25]
    np.testing.assert_array_equal(y[:, :2], q * c)
    np.testing.assert_allclose(y[:, 2:], (c - past) * q / (window * H), rtol=1e-14, atol=0)


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

"""Saturation and rate limit, against NumPy and against what they promise."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import rate_limit, sampled, saturation
from hypothesis import given, settings
from hypothesis import strategies as st

H = 1e-3
SIGNALS = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=25)


@settings(max_examples=60)
@given(signal=SIGNALS, lower=st.floats(-50, 50), width=st.floats(1e-3, 100))
def test_saturation_is_exact(signal: list[float], lower: float, width: float) -> None:
    """Inside the limits nothing changes to the last bit; outside the limit itself comes out."""
    block = saturation(lower=lower, upper=lower + width, sample_time=H)
    np.testing.assert_array_equal(sampled(block, signal)[:, 0], np.clip(signal, lower, lower + width))


def test_limits_for_each_channel_are_parameters() -> None:
    """Each channel has limits of its own, which can be tuned."""
    block = saturation(lower=[-1.0, -2.0], upper=[3.0, 4.0], sample_time=H)
    u = np.outer([-9.0, 0.5, 9.0], [1.0, 1.0])
    np.testing.assert_array_equal(sampled(block, u), [[-1.0, -2.0], [0.5, 0.5], [3.0, 4.0]])
    changed = {"joint1.torque.minimum": -0.1, "joint2.torque.maximum": 0.1}
    np.testing.assert_array_equal(sampled(block, u, changed), [[-0.1, -2.0], [0.5, 0.1], [3.0, 0.1]])


def reference_rate_limit(u: np.ndarray, rising: float, falling: float, last: float) -> np.ndarray:
    """The law in plain NumPy."""
    y = []
    for value in u:
        upper, lower = last + rising * H, last - falling * H
        last = value if -falling * H <= value - last <= rising * H else (upper if value > last else lower)
        y.append(last)
    return np.array(y)


@settings(max_examples=60)
@given(signal=SIGNALS, rising=st.floats(1e-6, 1e6), falling=st.floats(1e-6, 1e6), initial=st.floats(-100, 100))
def test_rate_limit(signal: list[float], rising: float, falling: float, initial: float) -> None:
    """It equals the law in NumPy bit by bit, and its steps never exceed the rates by more than rounding."""
    block = rate_limit(rising, falling, sample_time=H, initial=(initial, initial))
    y = sampled(block, signal)[:, 0]
    np.testing.assert_array_equal(y, reference_rate_limit(np.array(signal), rising, falling, initial))
    steps = np.diff([initial, *y])
    slack = 1e-12 * (1e3 + H * max(rising, falling))
    assert (steps <= rising * H + slack).all()
    assert (steps >= -falling * H - slack).all()


@pytest.mark.parametrize("falling", [None, 7.0])
def test_rates_are_parameters_with_units(falling: float | None) -> None:
    """The rates can be tuned; one number counts for both directions."""
    block = rate_limit(5.0, falling, signal="velocity", sample_time=H)
    assert [(each.name, each.unit, each.start, each.tunable) for each in block.parameters[::2]] == [
        ("joint1.velocity.rising_rate", "rad/s2", 5.0, True),
        ("joint1.velocity.falling_rate", "rad/s2", falling or 5.0, True),
    ]

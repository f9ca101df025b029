"""Saturation and rate limit, against NumPy and against what they promise."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import rate_limit, sampled, saturation

H = 1e-3


def test_limits_for_each_channel_are_parameters() -> None:
    """Each channel has limits of its own, which can be tuned."""
    block = saturation(lower=[-1.0, -2.0], upper=[3.0, 4.0], sample_time=H)
    u = np.outer([-9.0, 0.5, 9.0], [1.0, 1.0])
    np.testing.assert_array_equal(sampled(block, u), [[-1.0, -2.0], [0.5, 0.5], [3.0, 4.0]])
    changed = {"joint1.torque.minimum": -0.1, "joint2.torque.maximum": 0.1}
    np.testing.assert_array_equal(sampled(block, u, changed), [[-0.1, -2.0], [0.5, 0.1], [3.0, 0.1]])


@pytest.mark.parametrize("falling", [None, 7.0])
def test_rates_are_parameters_with_units(falling: float | None) -> None:
    """The rates can be tuned; one number counts for both directions."""
    block = rate_limit(5.0, falling, signal="velocity", sample_time=H)
    assert [(each.name, each.unit, each.start, each.tunable) for each in block.parameters[::2]] == [
        ("joint1.velocity.rising_rate", "rad/s2", 5.0, True),
        ("joint1.velocity.falling_rate", "rad/s2", falling or 5.0, True),
    ]

"""First-order lag against its closed forms."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.cosim.imperfections.channels import Channel, joint_channels
from flexfmu.cosim.imperfections.lag import lag

TORQUE = Channel("joint1.torque", "N.m", 2.0)


@settings(derandomize=True, deadline=None, max_examples=40)
@given(ratio=st.floats(0.01, 10.0), height=st.floats(-100.0, 100.0))
def test_step_response(run: Any, ratio: float, height: float) -> None:
    """A step gives height + (initial - height) exp(-t / T) at the sample instants, however long the samples are."""
    h = 1e-3
    y = run(lag([TORQUE], h / ratio, sample_time=h), np.full(60, height))[:, 0]
    expected = height + (2.0 - height) * np.exp(-ratio * np.arange(60))
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-14 * (abs(height) + 2.0) * 60)


def test_held_inputs_are_exact(run: Any) -> None:
    """It is the zero-order-hold equivalent of 1 / (T s + 1), as the control library has it."""
    h, u = 2.5e-4, np.random.default_rng(2).normal(size=400)
    y = run(lag([Channel("a", "N.m", 0.0)], 1.1e-3, sample_time=h), u)[:, 0]
    system = control.sample_system(control.tf([1.0], [1.1e-3, 1.0]), h, "zoh")
    expected = control.forced_response(system, T=h * np.arange(400), U=u).outputs
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-13)


def test_time_constants_are_parameters_and_zero_is_one_sample_of_delay(run: Any) -> None:
    """Each channel has its own time constant; the limit T = 0 is finite."""
    block = lag(joint_channels("torque", (1.0, 1.0)), [0.0, 1e-3], sample_time=1e-3)
    u = np.outer([3.0, -2.0, 5.0, 0.0], [1.0, 1.0])
    y = run(block, u)
    np.testing.assert_array_equal(y[:, 0], [1.0, 3.0, -2.0, 5.0])
    np.testing.assert_array_equal(run(block, u, {"joint2.torque.time_constant": 0.0})[:, 1], y[:, 0])
    assert y[1, 1] == 3.0 + np.exp(-1.0) * (1.0 - 3.0)

"""The delay that a block declares at low frequency, against how late a ramp comes out of it."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
import pytest
from blocks import cascade, context, delay, encoder, high_pass, jitter, lag, sampled

from flexfmu import filters
from flexfmu.cosim.control.filters import SecondOrder, biquad, filter_block, lead_lag, low_pass, notch
from flexfmu.model.symbolic import SymbolicBlock

H = 2.5e-3
COUNT = 2500
"""Samples, enough for what is drawn below to reach its steady state."""

AT_REST: Any = {"sample_time": H, "initial": (0.0, 0.0)}
Draw = np.random.Generator


def drive(time_constant: float) -> SymbolicBlock:
    """A current loop."""
    loop = {"proportional": 1.0}
    return cascade(loop, loop, {"time_constant": time_constant}, **AT_REST)[2]


def delayed(rng: Draw) -> SymbolicBlock:
    """A delay by any of the interpolations."""
    order = int(rng.integers(1, 6))
    rule = {"kind": "lagrange" if rng.random() < 0.5 else "thiran", "order": order}
    return delay(H * (order + rng.uniform(-0.4, 20.0)), rule, **AT_REST)


def filtered(rng: Draw) -> SymbolicBlock:
    """One or two filters, up to 0.45 times the sampling frequency."""
    frequency, other = rng.uniform(0.02, 0.45, 2) / H
    order = int(rng.integers(1, 9))
    kinds: list[Callable[[], list[SecondOrder]]] = [
        lambda: low_pass(frequency, order),
        lambda: notch(frequency, rng.uniform(0.3, 1.0), rng.uniform(0.0, 0.9)),
        lambda: lead_lag(frequency, other),
        lambda: biquad([2.0, 300.0 * rng.random(), 9e4], [1.0, 500.0, 6e4], frequency if rng.random() < 0.5 else None),
    ]
    chosen = rng.integers(0, len(kinds), rng.integers(1, 3))
    return filter_block(
        filters.notch(frequency=1.0, sample_time=H),
        context("filter"),
        [each for kind in chosen for each in kinds[kind]()],
    )


DRAWN: dict[str, Callable[[Draw], SymbolicBlock]] = {
    "whole delay": lambda rng: delay(H * int(rng.integers(0, 60)), **AT_REST),
    "delay": delayed,
    "lag": lambda rng: lag(H * rng.uniform(0.05, 30.0), **AT_REST),
    "encoder": lambda rng: encoder(1e10, window=int(rng.integers(1, 9)), sample_time=H),
    "current loop": lambda rng: drive(H * rng.uniform(0.05, 30.0)),
    "current loop of zero": lambda rng: drive(0.0),
    "filter": filtered,
    "high-pass": lambda rng: high_pass(frequency=rng.uniform(0.02, 0.45) / H, order=3, sample_time=H),
}


def lateness(block: SymbolicBlock) -> np.ndarray:
    """How late each output is [s], in time (N, outputs): an input that is the time itself comes out as gain · (t - delay).

    An encoder's rate is the time itself where its angle is half of the time squared. Without a gain nothing is late.
    """
    t = H * np.arange(COUNT)
    found = []
    for i, each in enumerate(block.outputs):
        y = sampled(block, 0.5 * t**2 if each.name.endswith("velocity") else t)[:, i]
        gain = np.diff(y)[-COUNT // 5 :].mean() / H
        found.append(t - y / gain if abs(gain) > 1e-9 else 0.0 * t)
    return np.array(found).T


@pytest.mark.parametrize("kind", DRAWN)
def test_a_declared_latency_is_that_of_a_ramp(kind: str) -> None:
    """The list of delays adds it up to the dead time of a loop; a lead isn't declared."""
    for seed in range(1 if "zero" in kind else 12 if kind == "filter" else 4):
        block = DRAWN[kind](np.random.default_rng(seed))
        late = lateness(block)[-COUNT // 5 :].mean(axis=0)
        declared = [block.latency.get(each.name, 0.0) for each in block.outputs]
        np.testing.assert_allclose(declared, np.maximum(late, 0.0), rtol=0.0, atol=1e-4 * H, err_msg=block.description)


@pytest.mark.parametrize("largest", [0.3, 1.0])
def test_jitter_declares_its_mean(largest: float) -> None:
    """Within six standard deviations of the mean of what was drawn."""
    block = jitter(largest * H, 1, signal="torque", **AT_REST)
    t = H * np.arange(COUNT)
    late = (t - sampled(block, t)[:, 0])[1:]
    declared = block.latency.get("joint1.torque", 0.0)
    assert abs(late.mean() - declared) <= 6.0 * largest * H / sqrt(12 * len(late)) + 1e-12


def test_a_continuous_lag_declares_how_late_a_ramp_is() -> None:
    """Of each channel, and after its time constant was set."""
    slave = lag(2e-3, initial=(0.0, 0.0))
    slave.set(np.array([3]), np.array([4e-3]))
    slave.initialize(0.0, 1.0, None)
    slave.set(np.arange(2), np.zeros(2))
    slave.set_derivatives(np.arange(2), np.ones((1, 2)))
    y = np.empty(2)
    slave.step(0.0, 1.0)
    slave.get(np.array([4, 5]), y)
    np.testing.assert_allclose([slave.latency[f"joint{k}.torque"] for k in (1, 2)], 1.0 - y, rtol=1e-9)

"""Imperfections in the master: at their own instants, in a chain, in a closed loop."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from blocks import delay, jitter, lag, noise, quantisation, rate_limit, saturation

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import AlgebraicLoopError
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable

H = 0.01
AT_REST = (0.3, 0.3)
"""Positions before the first sample."""


class Ramp:
    """joint1.position = 0.3 + 2 t."""

    name = "ramp"
    variables = (SlaveVariable("joint1.position", "output", "rad"),)

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.time = start_time

    def set(self, indices: Indices, values: RealArray) -> None: ...

    def get(self, indices: Indices, values: RealArray) -> None:
        values[0] = 0.3 + 2.0 * self.time

    def step(self, time: float, step: float) -> None:
        self.time = time + step


def test_delay_in_time() -> None:
    """At its instants offset + k h a delay gives the signal of that time before, and holds it until the next."""
    offset = H / 2
    slaves = [Ramp(), BlockSlave(delay(3.25 * H, signal="position", sample_time=H, offset=offset, initial=AT_REST))]
    result = simulate(connect(slaves, [("ramp.joint1.position", "delay.joint1.position.input")]), stop=0.2, step=H / 4)
    assert result.outcome is Outcome.COMPLETED, result.message
    time, y = result.recording.time, result.recording["delay.joint1.position"].values
    instant = offset + H * np.floor((time - offset) / H + 1e-9)
    filled = time > 6 * H
    held = filled & (np.abs(time - instant) > H / 8)
    np.testing.assert_allclose(y[held], 0.3 + 2.0 * (instant[held] - 3.25 * H), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(y[time < 3 * H], 0.3)


def test_a_chain_is_its_links_one_after_the_other(run: Any) -> None:
    """Clock, converter, noise and wire in a row give what the blocks give one after the other, at the same instants."""
    blocks = [
        jitter(0.3 * H, 1, sample_time=H, initial=AT_REST),
        quantisation(1e-3, sample_time=H),
        noise(1e-4, seed=1, sample_time=H),
        delay(2 * H, signal="position", sample_time=H, initial=AT_REST),
        saturation(lower=0.0, upper=0.6, signal="position", sample_time=H),
    ]
    names = ["ramp", *(block.name for block in blocks)]
    wiring = [(f"{source}.joint1.position", f"{target}.joint1.position.input") for source, target in pairwise(names)]
    result = simulate(connect([Ramp(), *map(BlockSlave, blocks)], wiring), stop=0.3, step=H)
    assert result.outcome is Outcome.COMPLETED, result.message
    expected = 0.3 + 2.0 * H * np.arange(31)
    for block in blocks:
        expected = run(block, expected)[:, 0]
    time, y = result.recording.time, result.recording["saturation.joint1.position"].values
    for k in range(30):
        between = y[(time > (k + 1e-6) * H) & (time < (k + 1 + 1e-6) * H)]
        np.testing.assert_allclose(between[0], expected[k], rtol=0, atol=1e-14)


def test_a_lag_breaks_a_loop() -> None:
    """A current loop or a delay in a closed loop makes it solvable instant by instant; without them it is refused."""
    limit = saturation(1.0, sample_time=H)
    around = [
        ("saturation.joint1.torque", "{}.joint1.torque.input"),
        ("{}.joint1.torque", "saturation.joint1.torque.input"),
    ]
    for block in (lag(0.1, sample_time=H, initial=(0.0, 0.0)), delay(H, sample_time=H, initial=(0.0, 0.0))):
        wiring = [(a.format(block.name), b.format(block.name)) for a, b in around]
        assert len(connect([BlockSlave(limit), BlockSlave(block)], wiring).slaves) == 2
    block = rate_limit(1.0, sample_time=H)
    wiring = [(a.format(block.name), b.format(block.name)) for a, b in around]
    with pytest.raises(AlgebraicLoopError, match=r"joint1\.torque"):
        connect([BlockSlave(limit), BlockSlave(block)], wiring)

"""Limits of every part that has some: reached by each joint, and never a mask of what is no number."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import backlash, cascade, computed_torque, dead_zone, pd, pid, rate_limit, responses, saturation

from flexfmu.model.symbolic import SymbolicBlock

H = 1e-3
LIMITS = {"torque_limit": [3.0, 20.0], "sample_time": H}
LOOPS = cascade(
    {"proportional": 100.0, "velocity_limit": [3.0, 20.0]},
    {"proportional": 100.0, "integral": 1.0},
    {"time_constant": 0.0},
    initial=(0.0, 0.0),
    **LIMITS,
)
TABLE = {"over": "load", "at": [-1.0, 2.0], "proportional": [1.0, 3.0]}
PARTS: dict[str, tuple[SymbolicBlock, str]] = {
    "PD": (pd(100.0, 0.0, **LIMITS), "reference.position"),
    "PID": (pid(100.0, 1.0, 0.01, filter_time=0.01, **LIMITS), "reference.position"),
    "computed torque": (computed_torque(900.0, 60.0, **LIMITS), "reference.acceleration"),
    "position loop": (LOOPS[0], "reference.position"),
    "velocity loop": (LOOPS[1], "command.velocity"),
    "current loop": (LOOPS[2], "command.torque"),
    "saturation": (saturation([3.0, 20.0], sample_time=H), "torque.input"),
}


@pytest.mark.parametrize("name", PARTS)
def test_limits_of_each_joint(name: str) -> None:
    """Outputs reach the limits of their joint, and don't go beyond."""
    block, signal = PARTS[name]
    far = np.repeat([-1e4, 1e4], 5)
    found = responses(block, {f"joint{i}.{signal}": far for i in (1, 2)})
    for values, limit in zip(found.values(), (3.0, 20.0), strict=True):
        assert (values[4], values[9]) == (-limit, limit)
        assert abs(values).max() == limit


@pytest.mark.parametrize(
    ("block", "signal"),
    [
        *((block, f"joint1.{signal}") for block, signal in PARTS.values()),
        (pd(50.0, 0.0, sample_time=H, schedule=TABLE), "load"),
        (dead_zone(0.5, sample_time=H), "joint1.torque.input"),
        (backlash(0.5, sample_time=H), "joint1.position.input"),
        (rate_limit(0.5, sample_time=H), "joint1.torque.input"),
    ],
)
def test_what_is_no_number_passes_every_limit(block: SymbolicBlock, signal: str) -> None:
    """It must not come out as a harmless looking limit, or as an end of a table: the run stops and says so."""
    given = {signal: [0.0, np.nan, 0.0]} | ({"joint1.position": [1.0] * 3} if signal == "load" else {})
    first, *then = next(iter(responses(block, given).values()))
    assert np.isfinite(first)
    assert np.isnan(then).any()

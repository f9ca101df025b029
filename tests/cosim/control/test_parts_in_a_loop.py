"""Parts of every kind in a sampled loop around an inertia, against simulations by hand with exact holds."""

from __future__ import annotations

from collections.abc import Callable
from math import exp, pi
from typing import Any

import numpy as np
import pytest
from axis_slave import Axis
from blocks import backlash, dead_zone, delay, lag, notch, pd, quantisation, rate_limit, saturation
from scipy import signal

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.model.symbolic import SymbolicBlock

H, COUNT = 1e-3, 250
K_P, K_D = 60.0, 2.4
AXIS = Axis((0.1, 0.5), load=0.0)

Law = Callable[[float], float]
"""What a part makes of its input at a sample; it remembers what it needs."""


def rejecting() -> Law:
    """A notch at 40 Hz: a bilinear quotient with this frequency exact, from the steady state of its first input on, by scipy."""
    w = 2.0 * pi * 40.0
    b, a = signal.bilinear([1.0, 0.08 * w, w * w], [1.0, 0.8 * w, w * w], w / (2.0 * np.tan(0.5 * w * H)))
    state: list[Any] = []

    def law(u: float) -> float:
        if not state:
            state.append(signal.lfilter_zi(b, a) * u)
        y, state[0] = signal.lfilter(b, a, [u], zi=state[0])
        return float(y[0])

    return law


def remembering(rule: Callable[[float, float], float], *last_output: float) -> Law:
    """A rule (last output, input) → output; without an output before the first one it is the first input."""
    last = [*last_output]

    def law(u: float) -> float:
        last[:] = [rule(last[0], u) if last else u]
        return last[0]

    return law


def late(samples: float) -> Law:
    """A delay with linear interpolation; before its line is full it has the first input."""
    line: list[float] = []
    whole, part = int(samples), samples - int(samples)

    def law(u: float) -> float:
        line.append(u)
        at = [line[max(len(line) - 1 - whole - k, 0)] for k in (0, 1)]
        return (1.0 - part) * at[0] + part * at[1]

    return law


def lagging(a: float) -> Law:
    """A sampled lag that has no feedthrough: what it was, then on its way to the input."""
    state = [0.0]

    def law(u: float) -> float:
        y = state[0]
        state[0] = a * y + (1.0 - a) * u
        return y

    return law


POSITION: Any = {"signal": "position", "initial": (0.1, 0.0)}
PARTS: dict[str, tuple[Callable[..., SymbolicBlock], tuple[Any, ...], Any, Callable[[], Law]]] = {
    "notch": (notch, (), {"frequency": 40.0, "damping": 0.4, "depth": 0.1, "signal": "position"}, rejecting),
    "dead zone": (dead_zone, (0.5,), {}, lambda: lambda u: max(u - 0.5, 0.0) + min(u + 0.5, 0.0)),
    "backlash": (backlash, (0.02,), {}, lambda: remembering(lambda last, u: min(max(last, u - 0.01), u + 0.01))),
    "saturation": (saturation, (), {"lower": -3.0, "upper": 2.0}, lambda: lambda u: min(max(u, -3.0), 2.0)),
    "rate limit": (
        rate_limit,
        (60.0, 40.0),
        {"initial": (0.5, 0.0)},
        lambda: remembering(lambda y, u: min(max(u, y - 0.04), y + 0.06), 0.5),
    ),
    "quantisation": (quantisation, (2e-3,), {}, lambda: lambda u: float(np.floor(u / 2e-3 + 0.5) * 2e-3)),
    "whole delay": (delay, (3 * H,), POSITION, lambda: late(3.0)),
    "delay": (delay, (2.3 * H,), POSITION, lambda: late(2.3)),
    "lag": (lag, (3e-3,), {"initial": (0.0, 0.0)}, lambda: lagging(exp(-1.0 / 3.0))),
}
"""Part in series with the position or the torque → its block's maker, values and keys, and its equations by hand."""


def by_hand(on_angle: Law, on_torque: Law) -> Any:
    """(N, 3) angle, rate and torque that reaches the axis, at all samples."""
    angle, rate, found = 0.1, 0.5, []
    for _ in range(COUNT):
        torque = on_torque(-K_P * on_angle(angle) - K_D * rate)
        found.append((angle, rate, torque))
        angle, rate = AXIS.moved(angle, rate, torque, H)
    return np.array(found)


@pytest.mark.parametrize("name", PARTS)
def test_a_part_in_a_loop(name: str) -> None:
    """PD, inertia and one part in series with the position or the torque: to 1e-12 at every instant."""
    make, values, keys, law = PARTS[name]
    part = make(*values, **keys, sample_time=H)
    into, out = (f"{part.name}.{each[0].name}" for each in (part.inputs, part.outputs))
    position, torque = "plant.joint1.position", "pd.joint1.torque"
    wires = [("plant.joint1.velocity", "pd.joint1.velocity")]
    if on_torque := out.endswith("torque"):
        wires += [(torque, into), (position, "pd.joint1.position"), (out, "plant.joint1.torque")]
    else:
        wires += [(position, into), (out, "pd.joint1.position"), (torque, "plant.joint1.torque")]
    slaves = [AXIS, BlockSlave(pd(K_P, K_D, sample_time=H)), BlockSlave(part)]
    result = simulate(connect(slaves, wires), stop=COUNT * H, step=H / 3.0)
    assert result.outcome is Outcome.COMPLETED, result.message

    def same(u: float) -> float:
        return u

    exact = by_hand(same, law()) if on_torque else by_hand(law(), same)
    # the last recorded value of an instant is that after its samples
    last = np.searchsorted(result.recording.time, H * np.arange(COUNT) + 1e-9) - 1
    for column, signal_name in zip(
        exact.T, (position, "plant.joint1.velocity", out if on_torque else torque), strict=True
    ):
        found = result.recording[signal_name].values[last]
        np.testing.assert_allclose(found, column, rtol=0.0, atol=1e-12 * abs(column).max(), err_msg=signal_name)
    assert abs(exact - by_hand(same, same)).max() > 1e-3, "the part makes a difference"

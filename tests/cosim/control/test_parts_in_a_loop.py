"""Filters, imperfections and disturbances in a sampled loop around an inertia, against simulations by hand with exact holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from math import exp, pi
from typing import Any

import numpy as np
import pytest
from axis_slave import Axis
from scipy import signal

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.pid import pd
from flexfmu.cosim.control.disturbances import band_noise, sine, steps, table
from flexfmu.cosim.control.filters import biquad, filter_block, high_pass, lead_lag, low_pass, notch
from flexfmu.cosim.control.imperfections.channels import Channel
from flexfmu.cosim.control.imperfections.delay import delay, whole_delay
from flexfmu.cosim.control.imperfections.lag import lag
from flexfmu.cosim.control.imperfections.signal_blocks import (
    backlash,
    dead_zone,
    quantisation,
    rate_limit,
    saturation,
)
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.model.symbolic import SymbolicBlock

MS = Fraction(1, 1000)
H = float(MS)
STOP = 250 * MS
K_P, K_D = 60.0, 2.4
POSITION = [Channel("axis.position", "rad")]
TORQUE = [Channel("axis.torque", "N.m")]

Law = Callable[[float], float]
"""What a part makes of its input at a sample; it remembers what it needs."""


AXIS = Axis((0.1, 0.5), load=0.0)


def quotient(b: Iterable[float], a: Iterable[float]) -> Law:
    """A difference equation that begins in the steady state of its first input, by scipy."""
    b, a = np.array(b), np.array(a)
    state: list[Any] = []

    def law(u: float) -> float:
        if not state:
            state.append(signal.lfilter_zi(b, a) * u)
        y, state[0] = signal.lfilter(b, a, [u], zi=state[0])
        return float(y[0])

    return law


def analogue(numerator: list[float], denominator: list[float], w: float) -> Law:
    """A quotient in s, bilinear with its exact frequency w [rad/s]."""
    return quotient(*signal.bilinear(numerator, denominator, w / (2.0 * np.tan(0.5 * w * H)) if w else 1.0 / H))


def in_series(*laws: Law) -> Law:
    """One after the other."""

    def law(u: float) -> float:
        for each in laws:
            u = each(u)
        return u

    return law


def remembering(rule: Callable[[float, float], float], first: float | None = None) -> Law:
    """A rule (last output, input) → output; without a first output it is the first input."""
    last: list[float] = [] if first is None else [first]

    def law(u: float) -> float:
        y = rule(last[0], u) if last else u
        last[:] = [y]
        return y

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


W = 2.0 * pi * 40.0
TIME: Any = {"sample_time": H}

PARTS: dict[str, tuple[Callable[[], SymbolicBlock], Callable[[], Law]]] = {
    "notch": (
        lambda: filter_block(POSITION, notch(40.0, 0.4, 0.1), **TIME),
        lambda: analogue([1.0, 0.08 * W, W * W], [1.0, 0.8 * W, W * W], W),
    ),
    "low-pass": (
        lambda: filter_block(POSITION, low_pass(120.0, 3), **TIME),
        lambda: quotient(*signal.butter(3, 120.0, fs=1.0 / H)),
    ),
    "high-pass": (
        lambda: filter_block(TORQUE, high_pass(20.0, 2), **TIME),
        lambda: quotient(*signal.butter(2, 20.0, "high", fs=1.0 / H)),
    ),
    "lead-lag": (
        lambda: filter_block(TORQUE, lead_lag(20.0, 90.0), **TIME),
        lambda: analogue([1.0 / (40.0 * pi), 1.0], [1.0 / (180.0 * pi), 1.0], 2.0 * pi * (20.0 * 90.0) ** 0.5),
    ),
    "biquad": (
        lambda: filter_block(POSITION, biquad([1.0, 20.0, 9e4], [1.0, 500.0, 9e4], 45.0), **TIME),
        lambda: analogue([1.0, 20.0, 9e4], [1.0, 500.0, 9e4], 90.0 * pi),
    ),
    "chain": (
        lambda: filter_block(POSITION, [*low_pass(150.0, 1), *biquad([1.0, 50.0, 9e4], [1.0, 500.0, 9e4])], **TIME),
        lambda: in_series(
            quotient(*signal.butter(1, 150.0, fs=1.0 / H)), analogue([1.0, 50.0, 9e4], [1.0, 500.0, 9e4], 0.0)
        ),
    ),
    "dead zone": (
        lambda: dead_zone(TORQUE, 0.5, **TIME),
        lambda: lambda u: max(u - 0.5, 0.0) + min(u + 0.5, 0.0),
    ),
    "backlash": (
        lambda: backlash(POSITION, 0.02, **TIME),
        lambda: remembering(lambda last, u: min(max(last, u - 0.01), u + 0.01)),
    ),
    "saturation": (lambda: saturation(TORQUE, -3.0, 2.0, **TIME), lambda: lambda u: min(max(u, -3.0), 2.0)),
    "rate limit": (
        lambda: rate_limit(TORQUE, 60.0, 40.0, **TIME),
        lambda: remembering(lambda last, u: min(max(u, last - 0.04), last + 0.06)),
    ),
    "quantisation": (
        lambda: quantisation(POSITION, 2e-3, **TIME),
        lambda: lambda u: float(np.floor(u / 2e-3 + 0.5) * 2e-3),
    ),
    "whole delay": (lambda: whole_delay([Channel("axis.position", "rad", 0.1)], 3, **TIME), lambda: late(3.0)),
    "delay": (lambda: delay([Channel("axis.position", "rad", 0.1)], 2.3 * H, **TIME), lambda: late(2.3)),
    "lag": (
        lambda: lag([Channel("axis.torque", "N.m", 0.0)], 3e-3, **TIME),
        lambda: lagging(exp(-1.0 / 3.0)),
    ),
}
"""Part in series with the position or the torque → its block, and its equations by hand."""


def pulse(time: Fraction) -> float:
    """2 N.m from 10.3 ms on, 0.5 N.m from 51 ms on."""
    return 2.0 * (MS * 103 / 10 <= time < MS * 51) + 0.5 * (time >= MS * 51)


def held_sine(time: Fraction) -> float:
    """3 sin(2 pi 30 t + 0.3) from 12.2 ms on for 60 ms, at each 0.7 ms since then."""
    since = time - MS * 122 / 10
    return float(3.0 * np.sin(60.0 * pi * float(since) + 0.3)) if 0 <= since < 60 * MS else 0.0


def rows(time: Fraction) -> float:
    """Three rows of a table, linear between them."""
    t = float(time)
    return float(np.interp(t, [0.0, 0.02, 0.05], [1.0, -2.0, 3.0])) if t <= 0.05 + 1e-12 else 0.0


NOISE: Any = {"sample_time": 7e-4, "components": 12}


def noise(time: Fraction) -> float:
    """Samples of the block alone: its closed form is in test_disturbances.py."""
    block = band_noise("axis.disturbance", 1.5, (5.0, 60.0), 3, **NOISE)
    slave, found = BlockSlave(block), np.empty(1)
    slave.initialize(0.0, 1.0, None)
    output = np.array([[each.causality for each in slave.variables].index("output")])
    for _ in range(round(time / (MS * 7 / 10)) + 1):
        slave.sample(0.0)
    slave.get(output, found)
    return float(found[0])


DISTURBANCES: dict[str, tuple[Callable[[], SymbolicBlock], Callable[[Fraction], float], list[Fraction]]] = {
    "pulse": (
        lambda: steps("axis.disturbance", [0.0103, 0.051], [2.0, 0.5]),
        pulse,
        [MS * 103 / 10, MS * 51],
    ),
    "sine": (
        lambda: sine("axis.disturbance", 3.0, 30.0, phase=0.3, start=0.0122, duration=0.06, sample_time=7e-4),
        held_sine,
        [MS * 122 / 10 + k * MS * 7 / 10 for k in range(330)],
    ),
    "table": (
        lambda: table("axis.disturbance", np.array([0.0, 0.02, 0.05]), np.array([1.0, -2.0, 3.0]), sample_time=7e-4),
        rows,
        [k * MS * 7 / 10 for k in range(350)],
    ),
    "noise": (
        lambda: band_noise("axis.disturbance", 1.5, (5.0, 60.0), 3, **NOISE),
        noise,
        [k * MS * 7 / 10 for k in range(60)],
    ),
}
"""Disturbance → its block, its value at an instant by hand, and its instants."""


def by_hand(
    part: Law | None, torque_part: Law | None, disturbance: Callable[[Fraction], float] | None, at: list[Fraction]
) -> Any:
    """(N, 4) time, angle, rate and torque that reaches the axis, at all instants."""
    angle, rate, torque, push = 0.1, 0.5, 0.0, 0.0
    before, found = Fraction(0), []
    samples, stop = {k * MS for k in range(int(STOP / MS))}, max(at, default=STOP) if disturbance is noise else STOP
    for now in sorted(each for each in samples | set(at) if each <= stop and each < STOP):
        angle, rate = AXIS.moved(angle, rate, torque + push, float(now - before))
        if now in at and disturbance is not None:
            push = disturbance(now)
        if now in samples:
            seen = part(angle) if part else angle
            torque = -K_P * seen - K_D * rate
            torque = torque_part(torque) if torque_part else torque
        found.append((float(now), angle, rate, torque))
        before = now
    return np.array(found)


def simulated(inline: SymbolicBlock | None, on_torque: bool, disturbance: SymbolicBlock | None) -> Any:
    """The recording of the same loop in the master."""
    blocks = [pd(K_P, K_D, sample_time=H, joints=("axis",)), *(each for each in (inline, disturbance) if each)]
    position, torque = "plant.axis.position", "pd.axis.torque"
    wires = [("plant.axis.velocity", "pd.axis.velocity")]
    if inline and on_torque:
        wires, torque = [*wires, (torque, f"{inline.name}.axis.torque.input")], f"{inline.name}.axis.torque"
    elif inline:
        wires, position = [*wires, (position, f"{inline.name}.axis.position.input")], f"{inline.name}.axis.position"
    wires += [(position, "pd.axis.position"), (torque, "plant.axis.torque")]
    if disturbance:
        wires.append((f"{disturbance.name}.axis.disturbance", "plant.axis.disturbance"))
    result = simulate(connect([AXIS, *map(BlockSlave, blocks)], wires), stop=float(STOP), step=float(MS / 3))
    assert result.outcome is Outcome.COMPLETED, result.message
    return result.recording, torque


def assert_equal(recording: Any, torque: str, exact: Any) -> None:
    """Angle, rate and torque to 1e-12 of their largest values, after the samples of each instant."""
    last = np.searchsorted(recording.time, exact[:, 0] + 1e-9) - 1
    np.testing.assert_allclose(recording.time[last], exact[:, 0], rtol=0.0, atol=1e-13)
    for column, name in ((1, "plant.axis.position"), (2, "plant.axis.velocity"), (3, torque)):
        scale = abs(exact[:, column]).max()
        np.testing.assert_allclose(
            recording[name].values[last], exact[:, column], rtol=0.0, atol=1e-12 * scale, err_msg=name
        )


@pytest.mark.parametrize("name", PARTS)
def test_a_part_in_a_loop(name: str) -> None:
    """PD, inertia and one part in series with the position or the torque: to 1e-12 at every instant."""
    make, law = PARTS[name]
    block = make()
    on_torque = block.outputs[0].name == "axis.torque"
    recording, torque = simulated(block, on_torque, None)
    exact = by_hand(None if on_torque else law(), law() if on_torque else None, None, [])
    assert_equal(recording, torque, exact)
    # the part makes a difference
    plain = by_hand(None, None, None, [])
    assert abs(exact - plain).max() > 1e-3


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_in_a_loop(name: str) -> None:
    """Its instants aren't those of the controller nor of the communication steps."""
    make, law, instants = DISTURBANCES[name]
    recording, torque = simulated(None, False, make())
    assert_equal(recording, torque, by_hand(None, None, law, instants))

"""Filters, imperfections and disturbances in a sampled loop around an inertia, against simulations by hand with exact holds."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from math import exp, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axis_slave import Axis
from blocks import (
    backlash,
    band_noise,
    biquad,
    context,
    dead_zone,
    delay,
    high_pass,
    lag,
    lead_lag,
    low_pass,
    notch,
    pd,
    quantisation,
    rate_limit,
    saturation,
    sine,
    table,
)
from scipy import signal

import flexfmu
from flexfmu.cosim.control import filters
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.disturbances import steps
from flexfmu.cosim.control.filters import filter_block
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.model.symbolic import SymbolicBlock

MS = Fraction(1, 1000)
H = float(MS)
STOP = 250 * MS
K_P, K_D = 60.0, 2.4

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
        lambda: notch(frequency=40.0, damping=0.4, depth=0.1, signal="position", **TIME),
        lambda: analogue([1.0, 0.08 * W, W * W], [1.0, 0.8 * W, W * W], W),
    ),
    "low-pass": (
        lambda: low_pass(frequency=120.0, order=3, signal="position", **TIME),
        lambda: quotient(*signal.butter(3, 120.0, fs=1.0 / H)),
    ),
    "high-pass": (
        lambda: high_pass(frequency=20.0, order=2, **TIME),
        lambda: quotient(*signal.butter(2, 20.0, "high", fs=1.0 / H)),
    ),
    "lead-lag": (
        lambda: lead_lag(20.0, 90.0, **TIME),
        lambda: analogue([1.0 / (40.0 * pi), 1.0], [1.0 / (180.0 * pi), 1.0], 2.0 * pi * (20.0 * 90.0) ** 0.5),
    ),
    "biquad": (
        lambda: biquad([1.0, 20.0, 9e4], [1.0, 500.0, 9e4], 45.0, signal="position", **TIME),
        lambda: analogue([1.0, 20.0, 9e4], [1.0, 500.0, 9e4], 90.0 * pi),
    ),
    "chain": (
        lambda: filter_block(
            flexfmu.filters.notch(frequency=1.0, signal="position", **TIME),
            context("filter"),
            [*filters.low_pass(150.0, 1), *filters.biquad([1.0, 50.0, 9e4], [1.0, 500.0, 9e4])],
        ),
        lambda: in_series(
            quotient(*signal.butter(1, 150.0, fs=1.0 / H)), analogue([1.0, 50.0, 9e4], [1.0, 500.0, 9e4], 0.0)
        ),
    ),
    "dead zone": (
        lambda: dead_zone(0.5, **TIME),
        lambda: lambda u: max(u - 0.5, 0.0) + min(u + 0.5, 0.0),
    ),
    "backlash": (
        lambda: backlash(0.02, **TIME),
        lambda: remembering(lambda last, u: min(max(last, u - 0.01), u + 0.01)),
    ),
    "saturation": (lambda: saturation(lower=-3.0, upper=2.0, **TIME), lambda: lambda u: min(max(u, -3.0), 2.0)),
    "rate limit": (
        lambda: rate_limit(60.0, 40.0, **TIME),
        lambda: remembering(lambda last, u: min(max(u, last - 0.04), last + 0.06)),
    ),
    "quantisation": (
        lambda: quantisation(2e-3, **TIME),
        lambda: lambda u: float(np.floor(u / 2e-3 + 0.5) * 2e-3),
    ),
    "whole delay": (lambda: delay(3 * H, signal="position", initial=(0.1, 0.0), **TIME), lambda: late(3.0)),
    "delay": (lambda: delay(2.3 * H, signal="position", initial=(0.1, 0.0), **TIME), lambda: late(2.3)),
    "lag": (
        lambda: lag(3e-3, initial=(0.0, 0.0), **TIME),
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


PUSH: Any = {"sample_time": 7e-4, "signal": "joint1.disturbance"}
ROWS = Path(__file__).with_name("rows.csv")
NOISE: Any = {"sample_time": 7e-4, "components": 12, "signal": "joint1.disturbance"}


def noise(time: Fraction) -> float:
    """Samples of the block alone: its closed form is in test_disturbances.py."""
    block = band_noise(1.5, (5.0, 60.0), seed=3, **NOISE)
    slave, found = BlockSlave(block), np.empty(1)
    slave.initialize(0.0, 1.0, None)
    output = np.array([[each.causality for each in slave.variables].index("output")])
    for _ in range(round(time / (MS * 7 / 10)) + 1):
        slave.sample(0.0)
    slave.get(output, found)
    return float(found[0])


DISTURBANCES: dict[str, tuple[Callable[[], SymbolicBlock], Callable[[Fraction], float], list[Fraction]]] = {
    "pulse": (
        lambda: steps("joint1.disturbance", {0.0103: 2.0, 0.051: 0.5}, "step"),
        pulse,
        [MS * 103 / 10, MS * 51],
    ),
    "sine": (
        lambda: sine(3.0, phase=0.3, frequency=30.0, start=0.0122, duration=0.06, **PUSH),
        held_sine,
        [MS * 122 / 10 + k * MS * 7 / 10 for k in range(330)],
    ),
    "table": (
        lambda: table(str(ROWS), **PUSH),
        rows,
        [k * MS * 7 / 10 for k in range(350)],
    ),
    "noise": (
        lambda: band_noise(1.5, (5.0, 60.0), seed=3, **NOISE),
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
    blocks = [pd(K_P, K_D, sample_time=H), *(each for each in (inline, disturbance) if each)]
    position, torque = "plant.joint1.position", "pd.joint1.torque"
    wires = [("plant.joint1.velocity", "pd.joint1.velocity")]
    if inline and on_torque:
        wires, torque = [*wires, (torque, f"{inline.name}.joint1.torque.input")], f"{inline.name}.joint1.torque"
    elif inline:
        wires, position = [*wires, (position, f"{inline.name}.joint1.position.input")], f"{inline.name}.joint1.position"
    wires += [(position, "pd.joint1.position"), (torque, "plant.joint1.torque")]
    if disturbance:
        wires.append((f"{disturbance.name}.joint1.disturbance", "plant.joint1.disturbance"))
    result = simulate(connect([AXIS, *map(BlockSlave, blocks)], wires), stop=float(STOP), step=float(MS / 3))
    assert result.outcome is Outcome.COMPLETED, result.message
    return result.recording, torque


def assert_equal(recording: Any, torque: str, exact: Any) -> None:
    """Angle, rate and torque to 1e-12 of their largest values, after the samples of each instant."""
    last = np.searchsorted(recording.time, exact[:, 0] + 1e-9) - 1
    np.testing.assert_allclose(recording.time[last], exact[:, 0], rtol=0.0, atol=1e-13)
    for column, name in ((1, "plant.joint1.position"), (2, "plant.joint1.velocity"), (3, torque)):
        scale = abs(exact[:, column]).max()
        np.testing.assert_allclose(
            recording[name].values[last], exact[:, column], rtol=0.0, atol=1e-12 * scale, err_msg=name
        )


@pytest.mark.parametrize("name", PARTS)
def test_a_part_in_a_loop(name: str) -> None:
    """PD, inertia and one part in series with the position or the torque: to 1e-12 at every instant."""
    make, law = PARTS[name]
    block = make()
    on_torque = block.outputs[0].name == "joint1.torque"
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

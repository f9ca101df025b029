"""Margins of drawn loops keep the identities between them, and their norms the bound of a symplectic pencil."""

from __future__ import annotations

from math import atan, inf, pi, sin

import numpy as np
import pytest
from scipy.linalg import eigvals

from flexfmu.cosim.design.margins.linear_blocks import LinearBlock
from flexfmu.cosim.design.margins.linear_loop import Continuous, LiftedLoop, LinearLoop
from flexfmu.cosim.design.margins.margins import LoopMargins, is_stable, pose_margins
from flexfmu.trajectories.jets import RealArray

T = 1e-3
LOOPS = 30


def block(a: RealArray, b: RealArray, c: RealArray, d: RealArray, sample_time: float, offset: float) -> LinearBlock:
    return LinearBlock(np.array(a), np.array(b), np.array(c), np.array(d), sample_time, offset)


def drawn(seed: int, ratio: float) -> LinearLoop:
    """One or two motors on a flexible robot with a damping ratio; PD controllers behind delays, every second one with two rates."""
    rng = np.random.default_rng(seed)
    several, joints, modes = seed % 2 == 1, 1 + (seed % 8 > 5), int(rng.integers(1, 3))
    # a rigid mode for each joint, then flexible ones
    frequencies = np.concatenate([np.zeros(joints), 2.0 * pi * np.exp(rng.uniform(np.log(15.0), np.log(400.0), modes))])
    n = len(frequencies)
    shape = np.hstack([np.eye(joints), rng.uniform(-0.7, 0.7, (joints, modes))])
    sensed = shape * np.hstack([np.ones((joints, joints)), rng.choice([1.0, 1.0, -0.5], (joints, modes))])
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(frequencies**2), -np.diag(2.0 * ratio * frequencies)]])
    c = np.block([[sensed, np.zeros_like(sensed)], [np.zeros_like(sensed), sensed]])
    g = np.vstack([np.zeros((n, joints)), shape.T])
    speed = 2.0 * pi * rng.uniform(5.0, 40.0, joints)
    late = rng.uniform(0.0, 1.0)
    # outputs: torques behind an interpolated delay; with two rates the positions come from sensors that sample more often
    sensors = 2 * joints if several else 0
    outputs = joints + sensors
    gains = -np.hstack([np.diag(speed**2), np.diag(1.4 * speed)])
    eye = np.eye(joints)
    nothing = np.zeros((joints, joints))
    controller = block(
        np.block([[nothing, nothing], [eye, nothing]]), np.vstack([gains, 0.0 * gains]),
        np.hstack([(1.0 - late) * eye, late * eye]), 0.0 * gains, T, 0.0 if not several else 0.2 * T,
    )  # fmt: skip
    taken = np.zeros((2 * joints, 2 * joints + outputs))
    taken[:, (2 * joints + joints if several else 0) :][:, : 2 * joints] = np.eye(2 * joints)
    blocks, inputs, calls = [controller], [taken], (0,)
    if several:
        mean = 0.5 * np.eye(sensors)
        sensor = block(np.zeros((sensors, sensors)), np.eye(sensors), mean, mean, 0.5 * T, 0.0)
        blocks, inputs, calls = [controller, sensor], [taken, np.eye(sensors, sensors + outputs)], (1, 0)
    held = np.zeros((2 * n, outputs)), np.zeros((2 * joints, outputs))
    continuous = Continuous(a, c, held, (g, np.zeros((2 * joints, joints))))
    return LinearLoop(continuous, tuple(blocks), calls, tuple(inputs), tuple(range(joints)))


def stable(seed: int, ratio: float) -> LinearLoop | None:
    """A drawn loop with gains that are small enough."""
    loop = drawn(seed, ratio)
    for factor in 0.6 ** np.arange(16):
        if is_stable(loop, factor):
            first = loop.blocks[0]
            scaled = LinearBlock(first.a, factor * first.b, first.c, first.d, first.sample_time, first.offset)
            return LinearLoop(loop.continuous, (scaled, *loop.blocks[1:]), loop.calls, loop.inputs, loop.channels)
    return None


def exceeds(system: LiftedLoop, scale: float, direct: float, level: float) -> bool:
    """Whether the gain of scale * system + direct exceeds a level, from the eigenvalues of its symplectic pencil.

    Source: S. Boyd, V. Balakrishnan and P. Kabamba, A bisection method for computing the H-infinity norm, Math. Control Signals
    Systems 2 (1989).
    """
    a, b, c = system.a, system.b, scale / level * system.c
    d = (scale * system.d + direct * np.eye(system.size)) / level
    n, p = len(a), system.size
    zero, none = np.zeros((n, n)), np.zeros((n, p))
    m = np.block([[a, zero, b], [zero, np.eye(n), none], [d.T @ c, b.T, d.T @ d - np.eye(p)]])
    e = np.block([[np.eye(n), zero, none], [c.T @ c, a.T, c.T @ d], [np.zeros((p, 2 * n + p))]])
    z = eigvals(m, e)
    angles = np.sort(np.angle(z[np.isfinite(z) & (np.abs(np.abs(z) - 1.0) < 0.03)]))
    angles = np.concatenate([angles, 0.5 * (angles[1:] + angles[:-1]), [0.0, pi]])
    found = c @ np.linalg.solve(np.exp(1j * angles)[:, None, None] * np.eye(n) - a, b[None]) + d
    return bool((np.linalg.norm(found, 2, axis=(1, 2)) > 1.0).any())


def check(loop: LinearLoop, row: LoopMargins, cut: LiftedLoop, single: bool) -> None:
    # norms: not exceeded by a thousandth; that they are reached is what their search has calculated
    assert not exceeds(cut.sensitivity, 1.0, 0.0, 1.001 * row.sensitivity_peak)
    if single and row.disk_margin < 2.0:
        assert not exceeds(cut.sensitivity, 2.0, -1.0, 1.001 * 2.0 / row.disk_margin)
    # identities
    rounding = 1.0 + 1e-3
    assert row.sensitivity_peak * rounding >= 1.0 / (2.0 * sin(0.5 * row.phase_margin))
    assert row.phase_margin * rounding >= 2.0 * atan(0.5 * row.disk_margin)
    if row.disk_margin < 2.0:
        bound = (2.0 + row.disk_margin) / (2.0 - row.disk_margin)
        assert row.gain_margin * rounding >= bound
        assert row.gain_reduction <= rounding / bound
    if row.gain_margin < inf:
        assert row.sensitivity_peak * rounding >= 1.0 / (1.0 - 1.0 / row.gain_margin)


def check_first(loop: LinearLoop, row: LoopMargins, cut: LiftedLoop, rng: np.random.Generator) -> None:
    """Below the margins all factors, phases and delays are stable, above them not."""
    everything = range(len(loop.channels))
    chosen = everything if row.channel == "all" else [everything.index(int(row.channel))]

    def radius(factor: complex, delay: float = 0.0) -> float:
        factors, delays = (
            tuple(x if i in chosen else none for i in everything) for x, none in ((factor, 1.0), (delay, 0.0))
        )
        return float(np.abs(np.linalg.eigvals(loop.closed(factors, delays))).max())

    count = int(cut.of.max()) + 1
    gain = min(row.gain_margin, 1e3)
    factors = np.concatenate([
        gain ** rng.uniform(0.0, 0.999, 24),
        max(row.gain_reduction, 1e-3) ** rng.uniform(0.0, 0.999, 24),
        np.exp(-1j * row.phase_margin * rng.uniform(0.0, 0.999, 24)),
    ])  # fmt: skip
    values = np.linalg.eigvals(cut.closed(np.repeat(factors[:, None], count, axis=1)))
    assert np.abs(values).max() < 1.0
    for delay in rng.uniform(0.0, 0.999, 6) * min(row.delay_margin, 40.0 * T):
        assert radius(1.0, float(delay)) < 1.0
    for critical, given in ((row.gain_margin, row.gain_margin < inf), (row.gain_reduction, row.gain_reduction > 0.0)):
        assert not given or abs(radius(critical) - 1.0) < 1e-6
    if row.phase_margin < pi:
        assert abs(radius(np.exp(-1j * row.phase_margin)) - 1.0) < 1e-6
    if row.delay_margin < inf:
        assert abs(radius(1.0, row.delay_margin) - 1.0) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.05, 0.01, 0.005, 0.0005])
def test_margins_of_drawn_loops_bound_each_other(ratio: float) -> None:
    """Peaks of lightly damped loops are narrow: none is missed, with one sample a period and with several."""
    number = found = 0
    while found < LOOPS:
        number += 1
        if (loop := stable(number, ratio)) is None:
            continue
        found += 1
        names = [str(i) for i in range(len(loop.channels))]
        pose = pose_margins(loop, names, 0.0, (0.0, 0.0), (0.0, 0.0))
        rng = np.random.default_rng(number)
        for row, cut in zip(pose.loops, pose.open, strict=True):
            check(loop, row, cut, single=row.channel != "all" or len(names) == 1)
            if found % 5 == 0:
                check_first(loop, row, cut, rng)

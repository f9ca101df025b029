"""Margins of a sampled loop: by how much its torques may be larger, smaller or later before it is unstable.

Gain, phase and delay margins are exact for the lifted loop: a factor or a delay at which an eigenvalue of the closed loop over a
period reaches the unit circle. Sensitivity and disk margins come from the lifted frequency response; with one sample a period they
are those of textbooks, with several they are bounds that also hold for perturbations that vary within the period.

Sources: K. J. Aström and R. M. Murray, *Feedback Systems*, Princeton 2021, chapters 10 and 13; P. Seiler, A. Packard and P. Gahinet,
An introduction to disk margins, IEEE Control Systems Magazine 40 (2020).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, log, nan, pi
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from flexfmu.cosim.choices.margins.linear_loop import ComplexArray, LiftedLoop, LinearLoop, Perturbation
from flexfmu.trajectories.jets import RealArray

LARGEST_GAIN, GAINS = 1e3, 40
"""Largest factor that is tried, also its inverse, and number of factors in between."""

PHASES, DELAYS, LONGEST = 36, 4, 40
"""Number of phases up to π, of delays in a sample time, and largest delay in sample times that are tried."""

FREQUENCIES = 400
"""Number of frequencies of the lifted response."""

LOWEST = 1e-4
"""Lowest frequency, relative to half the sampling frequency of the period's shortest sample time."""

EXACT = 1e-9
"""Relative error of critical factors and delays."""

ALL = "all"
"""Name of the row in which all channels change together."""


@dataclass(frozen=True)
class LoopMargins:
    """Margins where the loop is cut: at one of the robot's torques, or at all of them at once.

    Attributes:
        channel: input of the robot, ``joint1.torque`` for example, or ``all``.
        gain_margin: least factor above 1 with which the loop is unstable; infinite if there is none up to 1000.
        gain_reduction: largest factor below 1 with which it is; 0 if there is none.
        phase_margin: [rad].
        delay_margin: [s]; infinite if it is longer than 40 samples.
        disk_margin: size of the disk of simultaneous changes of gain and phase, between 0 and 2.
        sensitivity_peak: largest gain from disturbances to what remains of them; NaN for an unstable loop.
        bandwidth: lowest frequency at which less than 3 dB of a disturbance are suppressed [rad/s]; NaN if all are, and for an
            unstable loop.
        crossover: highest frequency at which the loop's gain is 1 [rad/s]; NaN if there is none.
    """

    channel: str
    gain_margin: float
    gain_reduction: float
    phase_margin: float
    delay_margin: float
    disk_margin: float
    sensitivity_peak: float
    bandwidth: float
    crossover: float


@dataclass(frozen=True, eq=False)
class PoseMargins:
    """Margins about an equilibrium.

    Attributes:
        s: where on the path, 0 to 1.
        position: x and y of the end effector [m].
        joints: joint angles [rad].
        radius: largest magnitude of an eigenvalue over a period; below 1 the loop is stable.
        poles: poles of the closed loop [rad/s], as if it were continuous, the slowest first.
        loops: a row for each channel, then for all at once.
        open: the lifted loop that is cut at each channel, and at all, for pictures.
    """

    s: float
    position: tuple[float, float]
    joints: tuple[float, float]
    radius: float
    poles: ComplexArray
    loops: tuple[LoopMargins, ...]
    open: tuple[LiftedLoop, ...]

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable."""
        return self.radius < 1.0


def pose_margins(
    loop: LinearLoop, names: Sequence[str], s: float, position: tuple[float, float], joints: tuple[float, float]
) -> PoseMargins:
    """The margins of a loop.

    Args:
        loop: the loop.
        names: names of its channels.
        s, position, joints: see `PoseMargins`.
    """
    values = np.linalg.eigvals(loop.closed(_factors(loop, range(0), 1.0)))
    radius = float(np.abs(values).max())
    # memories of constant values and states that decay at once aren't poles
    some = values[np.abs(values) > 1e-12]
    poles = np.log(some) / float(loop.period)
    # rounding of eigenvalues
    poles[np.abs(poles.imag) < 1e-9 * np.abs(poles)] = poles[np.abs(poles.imag) < 1e-9 * np.abs(poles)].real
    groups = [(name, [i]) for i, name in enumerate(names)] + ([(ALL, [*range(len(names))])] if len(names) > 1 else [])
    opened = [loop.opened(channels) for _, channels in groups]
    rows = tuple(
        _loop_margins(loop, name, channels, cut, radius < 1.0)
        for (name, channels), cut in zip(groups, opened, strict=True)
    )
    return PoseMargins(s, position, joints, radius, poles[np.argsort(-poles.real)], rows, tuple(opened))


def is_stable(loop: LinearLoop, factor: float = 1.0) -> bool:
    """Whether the loop is stable with all torques multiplied by a factor."""
    return _radius(loop, _factors(loop, range(len(loop.channels)), factor)) < 1.0


def growth(loop: LinearLoop) -> complex:
    """The pole of the closed loop [1/s] that grows fastest, or decays slowest, with its frequency [rad/s]."""
    values = np.linalg.eigvals(loop.closed(_factors(loop, range(0), 1.0)))
    largest = values[int(np.abs(values).argmax())]
    return complex(np.log(largest) / float(loop.period))


def critical_gain(loop: LinearLoop, beyond: float) -> float:
    """The factor of all torques between 1 and another one at which a stable loop becomes unstable, or an unstable one stable."""
    everything = range(len(loop.channels))
    found = brentq(lambda x: _radius(loop, _factors(loop, everything, np.exp(x))) - 1.0, 0.0, log(beyond), rtol=EXACT)
    return float(np.exp(found))


def _loop_margins(loop: LinearLoop, name: str, channels: Sequence[int], cut: LiftedLoop, stable: bool) -> LoopMargins:
    """The margins of a group of channels; of an unstable loop only its crossover."""
    frequencies = _frequencies(loop)
    single = LoopMargins(name, 1.0, 1.0, 0.0, 0.0, 0.0, *_responses(cut, frequencies))
    if not stable:
        return replace(single, sensitivity_peak=nan, bandwidth=nan)

    def by(change: Callable[[float], Perturbation]) -> Callable[[float], float]:
        return lambda value: _radius(loop, change(value)) - 1.0

    def factor(value: float) -> Perturbation:
        return _factors(loop, channels, np.exp(value))

    def turned(value: float) -> Perturbation:
        return _factors(loop, channels, np.exp(-1j * value))

    def late(value: float) -> Perturbation:
        delays = [value if i in channels else 0.0 for i in range(len(loop.channels))]
        return Perturbation((1.0,) * len(delays), tuple(delays))

    grid = np.linspace(0.0, log(LARGEST_GAIN), GAINS)
    upper, lower = _first(by(factor), grid), _first(by(factor), -grid)
    phase = _first(by(turned), np.linspace(0.0, pi, PHASES + 1))
    sample = min(loop.owner(i).sample_time for i in channels)
    delay = _first(by(late), sample / DELAYS * np.arange(DELAYS * LONGEST + 1.0))
    return replace(
        single,
        gain_margin=float(np.exp(upper)),
        gain_reduction=float(np.exp(lower)) if isfinite(lower) else 0.0,
        phase_margin=phase if isfinite(phase) else pi,
        delay_margin=delay,
        disk_margin=_disk(cut, frequencies),
    )


def _factors(loop: LinearLoop, channels: Sequence[int], factor: complex) -> Perturbation:
    count = len(loop.channels)
    return Perturbation(tuple(factor if i in channels else 1.0 for i in range(count)), (0.0,) * count)


def _radius(loop: LinearLoop, perturbation: Perturbation) -> float:
    return float(np.abs(np.linalg.eigvals(loop.closed(perturbation))).max())


def _first(excess: Callable[[float], float], grid: RealArray) -> float:
    """The first value of a grid's course at which the excess is 0; infinite, with the grid's sign, if there is none."""
    last = float(grid[0])
    for value in grid[1:].tolist():
        if excess(value) >= 0.0:
            return float(brentq(excess, last, value, rtol=EXACT)) if excess(last) < 0.0 else last
        last = value
    return inf if last >= 0.0 else -inf


def _frequencies(loop: LinearLoop) -> RealArray:
    """Angular frequencies up to nearly half the sampling frequency, in equal ratios [rad/s]."""
    highest = 0.999 * pi / min(loop.owner(i).sample_time for i in range(len(loop.channels)))
    return np.geomspace(LOWEST * highest, highest, FREQUENCIES)


def _responses(cut: LiftedLoop, frequencies: RealArray) -> tuple[float, float, float]:
    """Peak of the sensitivity, bandwidth and crossover."""
    identity = np.eye(cut.size)
    peak = _largest(lambda w: _gain(np.linalg.inv(identity + cut.response(w))), frequencies)
    fundamental = cut.fundamental(frequencies)
    size = fundamental.shape[-1]
    remaining = _gain(np.linalg.inv(np.eye(size) + fundamental))
    above = np.flatnonzero(remaining >= np.sqrt(0.5))
    gains = _gain(fundamental)
    large = np.flatnonzero(gains >= 1.0)
    bandwidth = float(frequencies[above[0]]) if above.size else float("nan")
    return peak, bandwidth, float(frequencies[large[-1]]) if large.size else float("nan")


def _disk(cut: LiftedLoop, frequencies: RealArray) -> float:
    """The disk margin 2 / max |S - T|, with the scaling of the channels that makes it largest."""
    identity = np.eye(cut.size)
    channels = np.array([i for i, _ in cut.times])
    of_last = channels == channels[-1]

    def gains(w: RealArray) -> RealArray:
        skewed = 2.0 * np.linalg.inv(identity + cut.response(w)) - identity
        if of_last.all():
            return _gain(skewed)
        # diagonal scalings don't change perturbations that act on each channel alone
        found = [skewed * np.where(of_last, d, 1.0)[:, np.newaxis] / np.where(of_last, d, 1.0) for d in SCALINGS]
        return np.asarray(np.min([_gain(each) for each in found], axis=0))

    return min(2.0, 2.0 / _largest(gains, frequencies))


SCALINGS = np.geomspace(0.05, 20.0, 25)
"""Scalings of the last channel against the others."""


def _gain(matrices: Any) -> RealArray:
    """Largest singular values (N,)."""
    return np.asarray(np.linalg.norm(matrices, 2, axis=(-2, -1)))


def _largest(gain: Callable[[RealArray], RealArray], frequencies: RealArray) -> float:
    """The largest gain over all frequencies, refined about the largest one of the grid."""
    values = gain(frequencies)
    k = int(values.argmax())
    near = frequencies[max(0, k - 1)], frequencies[min(len(frequencies) - 1, k + 1)]
    found = minimize_scalar(lambda w: -float(gain(np.array([w]))[0]), bounds=near, method="bounded")
    return max(float(values[k]), -float(found.fun))

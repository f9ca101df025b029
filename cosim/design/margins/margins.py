"""Margins of a sampled loop: by how much its torques may be larger, smaller or later before it is unstable.

Gain, phase and delay margins are exact for the lifted loop: a factor or a delay at which an eigenvalue of the closed loop over a
period reaches the unit circle. The search for it begins where the disk margin ends. Sensitivity and disk margins are the largest gains of
the lifted frequency response, which peaks about the closed loop's poles: they are among its frequencies. With one sample a period they
are those of textbooks, with several they are bounds that also hold for perturbations that vary within the period. So they bound each
other: peak S ≥ 1 / (2 sin(phase margin / 2)), gain margin ≥ (2 + disk) / (2 - disk), phase margin ≥ 2 atan(disk / 2).

Sources: K. J. Aström and R. M. Murray, *Feedback Systems*, Princeton 2021, chapters 10 and 13; P. Seiler, A. Packard and P. Gahinet,
An introduction to disk margins, IEEE Control Systems Magazine 40 (2020).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from math import atan, exp, inf, isfinite, isnan, log, nan, pi
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from flexfmu.cosim.design.margins.linear_loop import ComplexArray, LinearLoop
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.metrics.metric_table import metric
from flexfmu.trajectories.jets import RealArray

LARGEST_GAIN, LOGARITHM = 1e3, 0.18
"""Largest factor that is tried, also its inverse, and the logarithm of the ratio of factors."""

AMPLE = 20.0
"""Factor that is far enough from instability."""

PHASES, DELAYS, LONGEST = 36, 2, 40
"""Number of phases up to π, of delays in a sample time, and largest delay in sample times that are tried."""

TOGETHER = 8
"""Number of factors whose eigenvalues are calculated at once."""

CLOSE = 0.3
"""Share of an eigenvalue's distance from the unit circle: nearer to it, a maximum between tried values is searched."""

FREQUENCIES = 400
"""Number of frequencies beside those about poles."""

LOWEST = 1e-4
"""Lowest frequency, relative to half the sampling frequency of the period's shortest sample time."""

EXACT = 1e-9
"""Relative error of critical factors, delays and crossings."""

ABOUT = np.concatenate([[0.0], *([-x, x] for x in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0))])
"""Frequencies about a pole, in units of its distance from the unit circle."""

NARROWEST, RESOLVED = 1e-9, 0.02
"""Smallest such distance, and largest one relative to the angle that equal ratios of frequencies don't resolve."""

PEAK = 1e-5
"""Relative gain of a peak at which its refinement ends."""

ALL = "all"
"""Name of the row in which all channels change together."""


@dataclass(frozen=True)
class LoopMargins:
    """Margins where the loop is cut: at one of the robot's torques, or at all of them at once.

    Attributes, but for the channel metrics with unit and label:
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
    gain_margin: Metric
    gain_reduction: Metric
    phase_margin: Metric
    delay_margin: Metric
    disk_margin: Metric
    sensitivity_peak: Metric
    bandwidth: Metric
    crossover: Metric

    @classmethod
    def of(cls, channel: str, *values: float) -> LoopMargins:
        """The margins at a channel from their values, in the order of the attributes."""
        return cls(channel, *map(metric, FIGURES, values))


FIGURES = tuple(each.name for each in fields(LoopMargins) if each.name != "channel")
"""Names of the margins."""


class OpenLoop(Protocol):
    """A loop that is cut at channels, as pictures need it; see `LiftedLoop`."""

    @property
    def period(self) -> float:
        """[s]."""

    @property
    def size(self) -> int:
        """Number of elements that are fed in a period."""

    def fundamental(self, omega: RealArray, /) -> ComplexArray:
        """Loop transfer functions for negative feedback at angular frequencies (N,) [rad/s], (N, channels, channels)."""


@dataclass(frozen=True, eq=False)
class PoseMargins:
    """Margins about an equilibrium.

    Attributes:
        s: where on the path, 0 to 1; NaN, as position and joints, about a point of a model.
        position: x and y of the end effector [m].
        joints: joint angles [rad].
        radius: largest magnitude of an eigenvalue over a period; below 1 the loop is stable.
        poles: poles of the closed loop [rad/s], as if it were continuous, the slowest first.
        loops: a row for each channel, then for all at once.
        open: the lifted loop that is cut at each channel, and at all, for pictures.
        payload: mass [kg] of the robot's payload; NaN where it isn't a scene's.
        robot: parameters of a robot that isn't the scene's, in words; empty for another payload alone.
        unstable: number of unstable poles of the closed loop around a measured response, of which radius and poles aren't known; None
            where they are.
    """

    s: float
    position: tuple[float, float]
    joints: tuple[float, float]
    radius: float
    poles: ComplexArray
    loops: tuple[LoopMargins, ...]
    open: tuple[OpenLoop, ...]
    payload: float = nan
    robot: str = ""
    unstable: int | None = None

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable."""
        return self.radius < 1.0 if self.unstable is None else not self.unstable

    def place(self, with_payload: bool = False) -> str:
        """Where it is, in words."""
        return "the point" if isnan(self.s) else f"path {self.s:.2f}{f', {self.carrier}' if with_payload else ''}"

    @property
    def carrier(self) -> str:
        """The robot in words: its payload, or what else differs from the scene's."""
        return self.robot or f"{self.payload:.4g} kg"

    @property
    def measures(self) -> tuple[float, ...]:
        """What is worse the smaller it is: gain margin, gain reduction, phase, delay and disk margin, peak of the sensitivity.

        They go from 0 for a loop that is about to be unstable to at most π; an unstable one has what its eigenvalues are beyond the
        unit circle, negative.
        """
        if not self.is_stable:
            return (-log(self.radius),) * 6
        return tuple(
            min(each)
            for each in zip(
                *(
                    (
                        *gain_measures(row.gain_reduction, row.gain_margin), row.phase_margin,
                        _bounded(1e3 * row.delay_margin), row.disk_margin, 1.0 / row.sensitivity_peak,
                    )
                    for row in self.loops
                ), strict=True,
            )
        )  # fmt: skip


def gain_measures(reduction: float, margin: float) -> tuple[float, float]:
    """Measures of the factors by which torques may be smaller or larger, 0 to 1; beyond `AMPLE` it doesn't matter by how much."""
    return tuple(_bounded(min(each, log(AMPLE))) for each in (-log(reduction) if reduction > 0.0 else inf, log(margin)))  # type: ignore[return-value]


def _bounded(value: float) -> float:
    """0 to 1 for 0 to infinity."""
    return value / (1.0 + value) if isfinite(value) else 1.0


def shown_robot(parameters: Mapping[str, float]) -> str:
    """Parameters of a robot in words."""
    return ", ".join(f"{name} = {value:.5g}" for name, value in parameters.items())


def pose_margins(
    loop: LinearLoop,
    names: Sequence[str],
    s: float,
    position: tuple[float, float],
    joints: tuple[float, float],
    payload: float = nan,
) -> PoseMargins:
    """The margins of a loop.

    Args:
        loop: the loop.
        names: names of its channels.
        s, position, joints, payload: see `PoseMargins`.
    """
    values = _closed_poles(loop)
    radius = float(np.abs(values).max())
    # memories of constant values and states that decay at once aren't poles
    some = values[np.abs(values) > 1e-12]
    poles = np.log(some) / float(loop.period)
    # rounding of eigenvalues
    poles[np.abs(poles.imag) < 1e-9 * np.abs(poles)] = poles[np.abs(poles.imag) < 1e-9 * np.abs(poles)].real
    groups = [(name, [i]) for i, name in enumerate(names)] + ([(ALL, [*range(len(names))])] if len(names) > 1 else [])
    cuts = [_Cut(loop, channels) for _, channels in groups]
    rows = tuple(cut.margins(name, radius < 1.0) for (name, _), cut in zip(groups, cuts, strict=True))
    opened = tuple(cut.opened for cut in cuts)
    slowest = np.asarray(poles[np.argsort(-poles.real)], complex)
    return PoseMargins(s, position, joints, radius, slowest, rows, opened, payload)


def frequencies_of(loop: LinearLoop) -> RealArray:
    """Angular frequencies [rad/s] at which responses of a loop are known well, see `pose_margins`."""
    return _Cut(loop, range(len(loop.channels))).frequencies


def is_stable(loop: LinearLoop, factor: float = 1.0) -> bool:
    """Whether the loop is stable with all torques multiplied by a factor."""
    return float(np.abs(np.linalg.eigvals(loop.lifted.closed([factor] * len(loop.channels)))).max()) < 1.0


def growth(loop: LinearLoop) -> complex:
    """The pole of the closed loop [1/s] that grows fastest, or decays slowest, with its frequency [rad/s]."""
    values = _closed_poles(loop)
    return complex(np.log(values[int(np.abs(values).argmax())]) / float(loop.period))


def gain_limits(loop: LinearLoop, most: float) -> tuple[float, float]:
    """Gain reduction and gain margin of all torques of a stable loop at once, see `LoopMargins`, up to a largest factor."""
    return _Cut(loop, range(len(loop.channels))).gains(0.0, most)


def critical_gain(loop: LinearLoop, beyond: float) -> float:
    """The factor of all torques between 1 and another one at which a stable loop becomes unstable, or an unstable one stable."""
    cut = _Cut(loop, range(len(loop.channels)))
    found = brentq(lambda x: np.abs(cut.eigenvalues(np.exp([x]))).max() - 1.0, 0.0, log(beyond), rtol=EXACT)
    return float(np.exp(found))


def _closed_poles(loop: LinearLoop) -> ComplexArray:
    return np.asarray(np.linalg.eigvals(loop.lifted.closed([1.0] * len(loop.channels))), complex)


class _Cut:
    """A loop that is cut at some channels."""

    def __init__(self, loop: LinearLoop, channels: Sequence[int]) -> None:
        self._loop, self._channels, self.opened = loop, channels, loop.lifted.part(channels)
        self._sample = min(loop.blocks[loop.owners[i]].sample_time for i in channels)

    def margins(self, name: str, stable: bool) -> LoopMargins:
        """The margins; of an unstable loop only its crossover."""
        crossover = self._crossing(lambda f: gain_of(f) - 1.0, -1)
        if not stable:
            return LoopMargins.of(name, 1.0, 1.0, 0.0, 0.0, 0.0, nan, nan, crossover)
        disk = self._disk()
        reduction, gain = self.gains(disk)
        # a phase turns one way: the other way is the conjugate
        known = 0.98 * 2.0 * atan(0.5 * disk)
        phase = _first(lambda x: self.eigenvalues(np.exp(-1j * x)), np.linspace(known, pi, PHASES + 1))
        delays = self._sample / DELAYS * np.arange(DELAYS * LONGEST + 1.0)
        delay = _first(lambda x: map(self._late, x.tolist()), delays)
        peak = peak_of(lambda z: gain_of(self.opened.sensitivity.transfer(z)), self._angles)[1]
        bandwidth = self._crossing(lambda f: gain_of(np.linalg.inv(np.eye(f.shape[-1]) + f)) - 0.5**0.5, 1)
        return LoopMargins.of(name, gain, reduction, min(phase, pi), delay, disk, peak, bandwidth, crossover)

    def gains(self, disk: float, most: float = LARGEST_GAIN) -> tuple[float, float]:
        """Gain reduction and gain margin, which lie beyond those of the disk margin."""
        known = 0.98 * log((2.0 + disk) / (2.0 - disk)) if disk < 2.0 else inf
        grid = np.arange(min(known, log(most)), log(most) + LOGARITHM, LOGARITHM)
        lower = _first(lambda x: self.eigenvalues(np.exp(-x)), grid)
        upper = _first(lambda x: self.eigenvalues(np.exp(x)), grid)
        return exp(-lower), exp(upper) if isfinite(upper) else inf

    def eigenvalues(self, factors: NDArray[Any]) -> ComplexArray:
        """Eigenvalues of the closed loop over a period with factors (K,) of the torques, (K, n)."""
        count = int(self.opened.of.max()) + 1
        return np.asarray(
            np.linalg.eigvals(self.opened.closed(np.repeat(factors[:, np.newaxis], count, axis=1))), dtype=complex
        )

    def _late(self, delay: float) -> ComplexArray:
        """Those with a delay [s]."""
        delays = [delay if i in self._channels else 0.0 for i in range(len(self._loop.channels))]
        return np.asarray(np.linalg.eigvals(self._loop.closed([1.0] * len(delays), delays)), complex)

    @cached_property
    def _angles(self) -> RealArray:
        """Angles from 0 to π in the z-plane: about the closed loop's poles, and in between."""
        poles = np.linalg.eigvals(self.opened.sensitivity.a).astype(complex)
        angles = np.linspace(0.0, pi, 33)
        return np.unique(np.concatenate([near(poles, 0.0, pi), angles, np.geomspace(1e-5, pi, 33)]))

    @cached_property
    def frequencies(self) -> RealArray:
        """Angular frequencies up to nearly half the sampling frequency: in equal ratios, and about poles and zeros [rad/s]."""
        highest, period = 0.999 * pi / self._sample, self.opened.period
        grid = np.geomspace(LOWEST * highest, highest, FREQUENCIES)
        # zeros are where poles go with large gains
        matrices = self.opened.a, self.opened.sensitivity.a, self.opened.closed([1e6] * (int(self.opened.of.max()) + 1))
        poles = np.concatenate([np.linalg.eigvals(each) for each in matrices])
        turns = 2.0 * pi * np.arange(0, int(highest * period / (2.0 * pi)) + 2)
        found = [near(poles, turn, highest * period, RESOLVED) / period for turn in turns]
        found = [each[each >= grid[0]] for each in found]
        return np.unique(np.concatenate([grid, *found]))

    @cached_property
    def _fundamental(self) -> ComplexArray:
        return self.opened.fundamental(self.frequencies)

    def _crossing(self, excess: Callable[[ComplexArray], RealArray], way: int) -> float:
        """The first frequency upwards (1) or downwards (-1) at which the excess of a response is 0, or the first one of all; else NaN."""
        grid = self.frequencies[::way]
        above = np.flatnonzero(excess(self._fundamental[::way]) >= 0.0)
        if not above.size or above[0] == 0:
            return float(grid[0]) if above.size else nan
        ends = grid[above[0] - 1], grid[above[0]]
        return float(brentq(lambda w: float(excess(self.opened.fundamental(np.array([w])))[0]), *ends, rtol=EXACT))

    def _disk(self) -> float:
        """The disk margin 2 / max |S - T|, with the scaling of the channels that makes it largest at each frequency.

        Diagonal scalings don't change perturbations that act on each channel alone.
        """

        def gains(z: ComplexArray, shares: Sequence[float]) -> RealArray:
            sensitivity = self.opened.sensitivity.transfer(z)
            return np.asarray(np.min([disk_gains(sensitivity, self.opened.of, each) for each in shares], axis=0))

        # the best scaling at the frequency of the peak, beside those that were the best at others, until the peak stays
        shares, peak = [1.0], inf
        for _ in range(SCALINGS):
            where, peak = peak_of(lambda z: gains(z, shares), self._angles)
            if (self.opened.of == self.opened.of.max()).all():
                break
            z = np.exp([1j * where])
            best = minimize_scalar(lambda x, z=z: float(gains(z, [exp(x)])[0]), bounds=(-1.0, 1.0), method="bounded")
            if best.fun >= (1.0 - ENOUGH) * peak:
                break
            shares.append(exp(float(best.x)))
        return min(2.0, 2.0 / peak)


def disk_gains(sensitivity: ComplexArray, of: NDArray[np.intp], share: float = 1.0) -> RealArray:
    """Gains (N,) of S - T = 2 S - I with the last channel scaled against the others: as it balances them, times a share.

    Args:
        sensitivity: S (N, p, p).
        of: the channel of each of the p elements.
        share: of the balanced scaling, which for one sample of two channels in a period is the best one.
    """
    skewed, last = 2.0 * sensitivity - np.eye(sensitivity.shape[-1]), of == of.max()
    if last.all():
        return gain_of(skewed)
    # norms of the blocks beside the diagonal
    out, back = (np.linalg.norm(skewed[:, a][:, :, b], axis=(1, 2)) for a, b in ((last, ~last), (~last, last)))
    known = (out > 0.0) & (back > 0.0)
    balance = np.sqrt(np.where(known, back, 1.0) / np.where(known, out, 1.0))
    scales = np.where(last, (share * balance)[:, np.newaxis], 1.0)
    return gain_of(skewed * scales[:, :, np.newaxis] / scales[:, np.newaxis])


SCALINGS, ENOUGH = 6, 2e-4
"""Largest number of scalings of the last channel against the others, and relative error of the peak."""


def _first(eigenvalues: Callable[[RealArray], Iterable[ComplexArray]], grid: RealArray) -> float:
    """The first value at which the largest magnitude of an eigenvalue is 1; infinite if there is none. At 0 the loop is stable.

    Between values of the grid an eigenvalue may leave the unit circle and come back: where one has a maximum close to it, there are
    further values.
    """

    def excess(value: float) -> float:
        (found,) = eigenvalues(np.array([value]))
        return float(np.abs(found).max()) - 1.0

    def crossing(values: RealArray, found: Iterable[ComplexArray]) -> float | None:
        for k, each in enumerate(found):
            if np.abs(each).max() >= 1.0:
                before = float(values[k - 1]) if k else 0.0
                return float(brentq(excess, before, values[k], rtol=EXACT)) if values[k] > before else before
        return None

    known: list[ComplexArray] = []
    for begin in range(0, len(grid), TOGETHER):
        known += [*eigenvalues(grid[begin : begin + TOGETHER])]
        for k in range(max(begin, 1), len(known)):
            if k > 1 and _may_leave(*known[k - 2 : k + 1]):
                between = np.linspace(grid[k - 2], grid[k], 2 * TOGETHER + 1)
                if (value := crossing(between, eigenvalues(between))) is not None:
                    return value
            if (value := crossing(grid[: k + 1][-2:], known[: k + 1][-2:])) is not None:
                return value
    return inf


def _may_leave(before: ComplexArray, now: ComplexArray, after: ComplexArray) -> bool:
    """Whether an eigenvalue has a maximum about now that may be beyond the unit circle, by a parabola."""
    some = now[np.abs(now) > 0.5]
    first, middle, last = (
        np.abs(each[np.abs(each - some[:, np.newaxis]).argmin(axis=1)]) for each in (before, some, after)
    )
    bend = 2.0 * middle - first - last
    rise = (last - first) ** 2 / np.where(bend > 0.0, 8.0 * bend, inf)
    return bool(((middle >= first) & (middle >= last) & (rise > (1.0 - CLOSE) * (1.0 - middle))).any())


def near(poles: NDArray[Any], turn: float, top: float, widest: float = inf) -> RealArray:
    """Angles about poles, plus whole turns, from 0 to a top; only of those that are narrow beside the angle."""
    poles = poles[np.abs(poles) > 1e-9]
    width, angle = np.maximum(np.abs(np.log(np.abs(poles))), NARROWEST), np.angle(poles) + turn
    narrow = width < widest * np.maximum(np.abs(angle), NARROWEST)
    found = (angle[narrow, np.newaxis] + width[narrow, np.newaxis] * ABOUT).ravel()
    return np.asarray(found[(found >= 0.0) & (found <= top)])


def gain_of(matrices: Any) -> RealArray:
    """Largest singular values (N,)."""
    if matrices.shape[-1] == 1:
        return np.asarray(np.abs(matrices[:, 0, 0]))
    return np.asarray(np.sqrt(np.linalg.eigvalsh(matrices @ matrices.conj().swapaxes(1, 2))[:, -1]))


def peak_of(gain: Callable[[ComplexArray], RealArray], angles: RealArray) -> tuple[float, float]:
    """The angle of the largest gain on the unit circle, and that gain: between the angles the largest maxima are refined."""
    values = gain(np.exp(1j * angles))
    while True:
        before = values.max()
        sides = np.pad(values, 1, constant_values=-inf)
        maxima = np.flatnonzero((values >= sides[:-2]) & (values >= sides[2:]))
        highest = maxima[np.argsort(values[maxima])[-3:]]
        ends = angles[np.clip(highest + np.array([[-1], [0], [1]]), 0, len(angles) - 1)]
        new = np.unique([a + share * (b - a) for a, b in pairwise(ends) for share in (0.25, 0.5, 0.75)])
        angles, order = np.unique(np.concatenate([angles, new]), return_index=True)
        values = np.concatenate([values, gain(np.exp(1j * new))])[order]
        k = int(values.argmax())
        near = values[max(k - 1, 0) : k + 2]
        # the maximum lies above the middle of three values by less than what they differ
        if values[k] <= (1.0 + PEAK) * before and near.min() >= (1.0 - 1e2 * PEAK) * values[k]:
            return float(angles[k]), float(values[k])

"""Polynomials on pieces of time, in Bernstein form: products, cuts at zeros, means and peaks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.metrics.bernstein import bernstein_basis, maximum_norm

SAMPLES = np.linspace(0.0, 1.0, 17)
"""Normalised times of each piece at which the instant of a peak is looked for."""

POINTS = 3000
"""Approximate number of points of a curve."""


@dataclass(frozen=True)
class Pieces:
    """Torque and speed of a shaft as polynomials on pieces of time.

    Attributes:
        start, duration: (n,) [s].
        torque, speed: (6, n) Bernstein control points.
    """

    start: RealArray
    duration: RealArray
    torque: RealArray
    speed: RealArray

    @cached_property
    def power(self) -> RealArray:
        """(11, n) control points of the mechanical power."""
        return multiplied(self.torque, self.speed)

    @cached_property
    def square(self) -> RealArray:
        """(11, n) control points of the torque's square."""
        return multiplied(self.torque, self.torque)

    def mean(self, control: RealArray) -> float:
        """Return the mean over time of polynomials: that of their control points."""
        return float(control.mean(axis=0) @ self.duration / self.duration.sum())

    def peak(self, control: RealArray) -> tuple[float, float]:
        """Return the largest magnitude of polynomials, and when it is reached [s]."""
        values = np.abs(_sampled(control))
        sample, piece = np.unravel_index(int(np.argmax(values)), values.shape)
        time = self.start[piece] + SAMPLES[sample] * self.duration[piece]
        return maximum_norm(control[..., np.newaxis]), float(time)

    def highest(self, control: RealArray) -> float:
        """Return the largest value of polynomials."""
        # values above the least are norms
        size = float(np.abs(control).max())
        return maximum_norm(control[..., np.newaxis] + size) - size

    def curves(self, *controls: RealArray) -> tuple[RealArray, list[RealArray]]:
        """Return times [s] and the values of polynomials then, about `POINTS` in the order of time."""
        theta = np.linspace(0.0, 1.0, int(np.clip(POINTS // self.start.size, 2, SAMPLES.size)))
        time = (self.start[:, np.newaxis] + np.outer(self.duration, theta)).ravel()
        return time, [_sampled(each, theta).T.ravel() for each in controls]


def divided(start: RealArray, duration: RealArray, control: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Return start, duration and control points (degree + 1, n, c) of pieces in which the first two channels keep their signs."""
    first = control[..., :2]
    # most pieces stay whole
    mixed = np.flatnonzero(((first.min(axis=0) < 0.0) & (first.max(axis=0) > 0.0)).any(axis=-1))
    if not mixed.size:
        return start, duration, control
    plain = np.ones(start.size, dtype=bool)
    plain[mixed] = False
    starts, durations, controls = [start[plain]], [duration[plain]], [control[:, plain]]
    # the others are cut at their zeros, from the left
    for index in mixed.tolist():
        zeros = sorted({0.0, 1.0, *(zero for channel in (0, 1) for zero in _zeros(control[:, index, channel]))})
        rest = control[:, index]
        for low, high in pairwise(zeros):
            piece, rest = _cut(rest, (high - low) / (1.0 - low))
            controls.append(piece[:, np.newaxis])
            starts.append(start[index : index + 1] + low * duration[index])
            durations.append((high - low) * duration[index : index + 1])
    order = np.argsort(np.concatenate(starts), kind="stable")
    return np.concatenate(starts)[order], np.concatenate(durations)[order], np.concatenate(controls, axis=1)[:, order]


def _zeros(control: RealArray) -> Iterator[float]:
    """Yield the zeros of a polynomial between 0 and 1, from its Bernstein control points (degree + 1,)."""
    if not (control.min() < 0.0 < control.max()):
        return
    degree = len(control) - 1
    # powers of theta, from differences of the control points
    powers = [math.comb(degree, k) * float(np.diff(control, n=k)[0]) for k in range(degree + 1)]
    size = max(map(abs, powers))
    while powers and abs(powers[-1]) <= 1e-14 * size:
        powers.pop()
    for root in np.polynomial.polynomial.polyroots(powers).tolist():
        if abs(complex(root).imag) < 1e-9 and 1e-9 < complex(root).real < 1.0 - 1e-9:
            yield complex(root).real


def _cut(control: RealArray, theta: float) -> tuple[RealArray, RealArray]:
    """Return the control points (degree + 1, c) before and after a normalised time, by de Casteljau's algorithm."""
    before, after, level = np.empty_like(control), np.empty_like(control), control
    for i in range(len(control)):
        before[i], after[-1 - i] = level[0], level[-1]
        level = (1.0 - theta) * level[:-1] + theta * level[1:]
    return before, after


def multiplied(first: RealArray, second: RealArray) -> RealArray:
    """Return the control points (2 d + 1, n) of the product of polynomials of degree d with control points (d + 1, n)."""
    degree = len(first) - 1
    product = np.zeros((2 * degree + 1, first.shape[1]))
    for i in range(degree + 1):
        for k in range(degree + 1):
            weight = math.comb(degree, i) * math.comb(degree, k) / math.comb(2 * degree, i + k)
            product[i + k] += weight * first[i] * second[k]
    return product


def _sampled(control: RealArray, theta: RealArray = SAMPLES) -> RealArray:
    """Return the values (k, n) at normalised times of polynomials with control points (degree + 1, n)."""
    return np.asarray(bernstein_basis(theta, len(control) - 1) @ control)

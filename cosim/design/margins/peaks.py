"""Largest gains on the unit circle of the z-plane, which lie about the poles: these are among the angles, the largest maxima are refined."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.design.margins.linear_loop import ComplexArray
from flexfmu.trajectories.jets import RealArray

ABOUT = np.concatenate([[0.0], *([-x, x] for x in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0))])
"""Frequencies about a pole, in units of its distance from the unit circle."""

NARROWEST, RESOLVED = 1e-9, 0.02
"""Smallest such distance, and largest one relative to the angle that equal ratios of frequencies don't resolve."""

PEAK = 1e-5
"""Relative gain of a peak at which its refinement ends."""


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


def largest(gain: Callable[[ComplexArray], RealArray], angles: RealArray) -> float:
    """The largest gain on the unit circle."""
    return peak_of(gain, angles)[1]


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

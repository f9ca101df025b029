"""Margins of a loop whose response is known at frequencies alone, by the loci of its eigenvalues (the generalised Nyquist criterion).

M(ω) leads from what is fed in where the loop is cut to what comes back. A factor k on it is critical where k M has the eigenvalue 1: for
gains where a locus crosses the real axis, for phases and delays where it crosses the unit circle. Which loop is stable, nothing here can
tell: a loop with margins is. Disk margin and peak of the sensitivity are the largest gains over the frequencies.

Sources: A. MacFarlane and I. Postlethwaite, The generalized Nyquist stability criterion and multivariable root loci, Int. J. Control 25
(1977); for the disk margin those of `flexfmu.cosim.design.margins.margins`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import inf, isfinite, nan, pi

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.design.margins.linear_loop import ComplexArray
from flexfmu.cosim.design.margins.margins import FIGURES, LARGEST_GAIN, LoopMargins, disk_gains, gain_of
from flexfmu.cosim.metrics.metric_table import metric
from flexfmu.trajectories.jets import RealArray

ROUNDS, PARTS = 3, 8
"""How often intervals of frequencies are refined in which a margin lies, and into how many parts."""

MAXIMA = 3
"""Number of maxima of a gain that are refined."""

SCALES, HIGHEST = np.exp(np.linspace(-1.0, 1.0, 9)), 40
"""Scalings of the last channel against the others that are tried about the balanced one, and the number of gains that they are tried for."""

TINY = 1e-300
"""Smallest magnitude of which there is a logarithm."""

REAL = 1e-9
"""Imaginary part relative to the magnitude below which a value is real."""

HALF_POWER = 0.5**0.5
"""Gain of -3 dB."""


def refined(
    matrices: Callable[[RealArray], ComplexArray], of: NDArray[np.intp], grid: RealArray, top: float = inf
) -> RealArray:
    """Angular frequencies (N,) [rad/s] with further ones up to a top where a margin lies; arguments as for `loop_figures`."""
    beyond, grid = grid[grid > top], grid[grid <= top]
    found = matrices(grid)
    for _ in range(ROUNDS):
        before, after = _pairs(found)
        inside = (_turns(before.imag, after.imag) & (before.real + after.real > 2.0 / LARGEST_GAIN)).any(axis=1)
        inside |= _turns(np.abs(before) - 1.0, np.abs(after) - 1.0).any(axis=1)
        sensitivity = np.asarray(np.linalg.inv(np.eye(found.shape[-1]) - found), complex)
        gains = gain_of(sensitivity), disk_gains(sensitivity, of)
        inside |= _turns(gains[0][:-1] - HALF_POWER, gains[0][1:] - HALF_POWER)
        for gain in gains:
            sides = np.pad(gain, 1, constant_values=-inf)
            maxima = np.flatnonzero((gain >= sides[:-2]) & (gain >= sides[2:]))
            highest = maxima[np.argsort(gain[maxima])[-MAXIMA:]]
            inside[np.clip([highest - 1, highest], 0, len(inside) - 1)] = True
        new = np.linspace(grid[:-1][inside], grid[1:][inside], PARTS + 1)[1:-1].ravel()
        grid, order = np.unique(np.concatenate([grid, new]), return_index=True)
        found = np.concatenate([found, matrices(new)])[order]
    return np.concatenate([grid, beyond])


def loop_figures(
    frequency: RealArray, matrices: ComplexArray, of: NDArray[np.intp], fundamental: ComplexArray, top: float = inf
) -> tuple[float, ...]:
    """The margins of a stable loop, in the order of `FIGURES`.

    Args:
        frequency: (N,) ascending angular frequencies [rad/s].
        matrices: M (N, p, p).
        of: the channel of each of the p elements, counted from 0.
        fundamental: the loop transfer functions of the channels for negative feedback, (N, channels, channels).
        top: frequency from which on M repeats itself.
    """
    matrices = matrices[frequency <= top]
    before, after = _pairs(matrices)
    # the real axis, on which both ends may lie
    turns = _turns(before.imag, after.imag)
    share = before.imag[turns] / (before.imag - after.imag)[turns]
    first, last = before[:1], np.linalg.eigvals(matrices[-1:])
    ends = [each.real[np.abs(each.imag) <= REAL * np.abs(each)] for each in (first, last)]
    real = np.concatenate([before.real[turns] + share * (after - before).real[turns], *ends])
    factors = 1.0 / real[real > 1.0 / LARGEST_GAIN]
    gain, reduction = factors[factors > 1.0].min(initial=inf), factors[factors <= 1.0].max(initial=0.0)
    # the unit circle; a delay turns what keeps the frequency
    phases, _ = _angles(frequency, before, after)
    angles, at = _angles(frequency, *_pairs(-fundamental))
    sensitivity = np.asarray(np.linalg.inv(np.eye(matrices.shape[-1]) - matrices), complex)
    remains = gain_of(np.linalg.inv(np.eye(fundamental.shape[-1]) + fundamental))
    return (
        float(gain), float(reduction) if reduction > 1.0 / LARGEST_GAIN else 0.0, float(np.abs([*phases, *angles]).min(initial=pi)),
        float(((angles % (2.0 * pi)) / at).min(initial=inf)), min(2.0, 2.0 / _disk_peak(sensitivity, of)),
        float(gain_of(sensitivity).max()), _crossing(frequency, remains - HALF_POWER, 1),
        _crossing(frequency, gain_of(fundamental) - 1.0, -1),
    )  # fmt: skip


def margins_with_errors(channel: str, figures: tuple[float, ...], drawn: Iterable[tuple[float, ...]]) -> LoopMargins:
    """The margins at a channel; the standard error of each is the scatter of those of drawn responses, if there are some."""
    rows = np.array([*drawn])
    errors: list[float | None] = [None] * len(figures)
    if len(rows):
        scatter = [row.std(ddof=1) if np.isfinite(row).all() else nan for row in rows.T]
        errors = [
            float(each) if isfinite(each) and isfinite(value) else None
            for each, value in zip(scatter, figures, strict=True)
        ]
    known = zip(FIGURES, figures, errors, strict=True)
    return LoopMargins(channel, *(metric(name, value, error=error) for name, value, error in known))


def _angles(frequency: RealArray, before: ComplexArray, after: ComplexArray) -> tuple[RealArray, RealArray]:
    """Angles at which loci cross the unit circle, and frequencies there."""
    sizes = np.log(np.maximum(np.abs(before), TINY)), np.log(np.maximum(np.abs(after), TINY))
    turns = _turns(*sizes)
    share, rows = sizes[0][turns] / (sizes[0] - sizes[1])[turns], np.nonzero(turns)[0]
    found = np.angle(before[turns] + share * (after - before)[turns])
    return found, frequency[rows] + share * np.diff(frequency)[rows]


def _pairs(matrices: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Eigenvalues (N - 1, p) at the beginning of each interval, and the nearest ones at its end."""
    values = np.asarray(np.linalg.eigvals(matrices), complex)
    nearest = np.abs(values[1:, np.newaxis] - values[:-1, :, np.newaxis]).argmin(axis=2)
    return values[:-1], np.take_along_axis(values[1:], nearest, axis=1)


def _turns(before: RealArray, after: RealArray) -> NDArray[np.bool_]:
    """Where the sign changes."""
    return np.asarray((before < 0.0) != (after < 0.0))


def _disk_peak(sensitivity: ComplexArray, of: NDArray[np.intp]) -> float:
    """Largest gain with the best scaling at each frequency; for one sample of each of two channels the balanced one is that."""
    gains = disk_gains(sensitivity, of)
    if len(of) > 2:
        highest = np.argsort(gains)[-HIGHEST:]
        gains[highest] = np.min([disk_gains(sensitivity[highest], of, each) for each in SCALES], axis=0)
    return float(gains.max())


def _crossing(frequency: RealArray, excess: RealArray, way: int) -> float:
    """The first frequency upwards (1) or downwards (-1) at which the excess is 0, or the first one of all; else NaN."""
    f, e = frequency[::way], excess[::way]
    above = np.flatnonzero(e >= 0.0)
    if not above.size or (k := int(above[0])) == 0:
        return float(f[0]) if above.size else nan
    return float(f[k] - e[k] * (f[k] - f[k - 1]) / (e[k] - e[k - 1]))

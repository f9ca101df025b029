"""Coloured noise of measured signals: autoregressive models of residuals, whitening, and tests of what is left.

Burg's method over several pieces gives reflection coefficients, and with them by Levinson's recursion predictors of all lower orders: they
whiten the first samples of each piece too, which makes the whitened residuals those of the exact Gaussian likelihood (P. Stoica,
R. Moses, *Spectral Analysis of Signals*, 2005, sections 3.5 and 3.9.3). The order is that of the least corrected information criterion of
Akaike (C. Hurvich, C. Tsai, Regression and time series model selection in small samples, Biometrika 76, 1989).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexfmu.cosim.engine.slave import RealArray

HIGHEST, SHARE = 30, 10
"""Highest order of a model, and samples that each of its coefficients needs at least."""

Piece = slice
"""Samples of a signal at equal distances."""


@dataclass(frozen=True)
class ColouredNoise:
    """An autoregressive model: e[n] = sum of a[k] e[n - k], k = 1 .. order, + white noise.

    Attributes:
        predictors: predictor of each order from 0 to that of the model, coefficients a[1], a[2] ...
        deviations: (order + 1,) standard deviation of what each of them leaves.
        step: distance of the samples [s].
        errors: (N,) what the noise is relative to; None for the signal's unit.
    """

    predictors: tuple[RealArray, ...]
    deviations: RealArray
    step: float
    errors: RealArray | None = None

    @property
    def order(self) -> int:
        """Order of the model; 0 for white noise."""
        return len(self.predictors) - 1

    @property
    def coloured(self) -> float:
        """Standard deviation of the noise itself."""
        return float(self.deviations[0])

    def whitened(self, values: RealArray, pieces: Sequence[Piece]) -> RealArray:
        """Return values (N, ...) as white noise of unit variance, piece by piece; the operator is linear and keeps the shape."""
        if self.errors is not None:
            values = (values.T / self.errors).T
        found = np.zeros_like(values)
        for piece in pieces:
            taken = values[piece]
            left = taken.copy()
            for k, factor in enumerate(self.predictors[-1].tolist(), 1):
                left[k:] -= factor * taken[:-k]
            found[piece] = left / self.deviations[-1]
            # the first samples by the predictors of lower orders
            for n in range(min(self.order, len(taken))):
                predicted = np.tensordot(self.predictors[n], taken[n - 1 :: -1][:n], axes=1) if n else 0.0
                found[piece.start + n] = (taken[n] - predicted) / self.deviations[n]
        return found

    @cached_property
    def resonances(self) -> list[tuple[float, float]]:
        """Frequency [Hz] and damping ratio of the model's pairs of poles, the least damped first."""
        poles = np.roots(np.append(1.0, -self.predictors[-1]))
        rates = np.log(poles[(poles.imag > 0.0) & (abs(poles) > 0.0)].astype(complex)) / self.step
        found = [(abs(each) / (2.0 * np.pi), -each.real / abs(each)) for each in rates.tolist()]
        return sorted(found, key=lambda each: each[1])


def fitted_noise(
    residuals: RealArray, pieces: Sequence[Piece], step: float, least: float = 0.0, errors: RealArray | None = None
) -> ColouredNoise:
    """Return the noise model of residuals (N,), by Burg's method over all pieces.

    Args:
        residuals: (N,).
        pieces: ranges of samples at equal distances.
        step: that distance [s].
        least: smallest standard deviation of what it leaves.
        errors: (N,) what the noise is relative to; None for the residuals' unit.
    """
    if errors is not None:
        residuals = residuals / errors
    count = sum(piece.stop - piece.start for piece in pieces)
    highest = max(min(HIGHEST, count // SHARE, max(piece.stop - piece.start for piece in pieces) - 2), 0)
    forward = [residuals[piece].astype(float) for piece in pieces]
    backward = [each.copy() for each in forward]
    power = sum(float(each @ each) for each in forward) / count
    floor = max(least**2, np.finfo(float).tiny)
    predictors, powers = [np.zeros(0)], [max(power, floor)]
    for _ in range(highest):
        ahead, behind = [each[1:] for each in forward], [each[:-1] for each in backward]
        above = 2.0 * sum(float(a @ b) for a, b in zip(ahead, behind, strict=True))
        below = sum(float(a @ a) + float(b @ b) for a, b in zip(ahead, behind, strict=True))
        if below <= count * floor:
            break
        k = above / below
        forward = [a - k * b for a, b in zip(ahead, behind, strict=True)]
        backward = [b - k * a for a, b in zip(ahead, behind, strict=True)]
        last = predictors[-1]
        predictors.append(np.append(last - k * last[::-1], k))
        powers.append(max(powers[-1] * (1.0 - k * k), floor))
    orders = np.arange(len(powers))
    criterion = count * np.log(powers) + 2.0 * (orders + 1) * count / np.maximum(count - orders - 2, 1)
    order = int(np.argmin(criterion))
    return ColouredNoise(tuple(predictors[: order + 1]), np.sqrt(powers[: order + 1]), step, errors)


def whiteness(white: RealArray, pieces: Sequence[Piece], lags: int = 20) -> float:
    """Return the probability that white noise has correlations as large as these residuals (Ljung and Box, Biometrika 65, 1978)."""
    from scipy.special import chdtrc

    count = sum(piece.stop - piece.start for piece in pieces)
    power = float(white @ white)
    lags = min(lags, max(piece.stop - piece.start for piece in pieces) - 1)
    if power == 0.0 or lags < 1:
        return 1.0
    found = 0.0
    for lag in range(1, lags + 1):
        products = sum(float(white[p][lag:] @ white[p][:-lag]) for p in pieces if p.stop - p.start > lag)
        found += (products / power) ** 2 / (count - lag)
    return float(chdtrc(lags, count * (count + 2) * found))


def independence(white: RealArray, inputs: RealArray, taken: int) -> float:
    """Return the probability that residuals which don't depend on the inputs are explained by them as well as these.

    The F test of the regression of whitened residuals on whitened inputs.

    Args:
        white: (N,) whitened residuals.
        inputs: (N, k) inputs at several lags, whitened by the same model.
        taken: degrees of freedom that the fit has taken from the residuals.
    """
    from scipy.linalg import lstsq
    from scipy.special import fdtrc

    columns = inputs / np.maximum(np.linalg.norm(inputs, axis=0), np.finfo(float).tiny)
    solution, _, rank, _ = lstsq(columns, white, cond=1e-8, lapack_driver="gelsy")
    explained, total = float((columns @ solution) @ white), float(white @ white)
    left = white.size - taken - rank
    if rank == 0 or left < 1 or total - explained <= 0.0:
        return 1.0
    return float(fdtrc(rank, left, explained / rank / ((total - explained) / left)))

"""Natural frequencies and damping ratios from a frequency response, by a rational fit that is weighted by the response's errors.

All elements share the poles. With poles given, the residues are linear: so the fit searches frequencies and damping ratios alone (variable
projection), and takes real residues of each mode, and real coefficients of what lies outside of the band: a rigid body below, a stiffness
above. Modes are added one by one where one explains most, until another one isn't worth its parameters (Schwarz's criterion).

Sources: G. Golub and V. Pereyra, Separable nonlinear least squares, Inverse Problems 19 (2003); R. Pintelon and J. Schoukens, *System
Identification: A Frequency Domain Approach*, 2nd ed., Wiley 2012, chapters 9 and 11.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.trajectories.jets import RealArray

MOST = 10
"""Largest number of modes that are looked for."""

STARTS, RATIOS = 80, (0.002, 0.02, 0.2)
"""Frequencies and damping ratios that are tried for a new mode."""

NORMAL = 1.959963984540054
"""Standard errors from the value to the ends of an interval that holds the truth in 95 % of cases."""

UNKNOWN = 100.0
"""Logarithm of the ratio from a value to the end of an interval that nothing limits."""

EXACT = 1e-8
"""Relative error of a fit below which it is exact."""


@dataclass(frozen=True)
class MeasuredMode:
    """A mode of a measured response.

    Attributes:
        frequency: natural frequency [Hz], with its standard error.
        damping_ratio: with its standard error.
        frequency_interval, damping_interval: of 95 % each.
    """

    frequency: Metric
    damping_ratio: Metric
    frequency_interval: tuple[float, float]
    damping_interval: tuple[float, float]


@dataclass(frozen=True, eq=False)
class _Data:
    """Values (N, m) of m elements with weights at the variable s or z (N,)."""

    variable: NDArray[np.complex128]
    values: NDArray[np.complex128]
    weights: RealArray
    sample_time: float | None

    def misfit(self, logarithms: RealArray) -> RealArray:
        """Weighted residuals of the best residues with modes of these logarithms of frequencies [rad/s], then of damping ratios."""
        omega, ratio = np.exp(logarithms.reshape(2, -1))
        poles = omega * (-ratio + 1j * np.sqrt(np.maximum(1.0 - ratio**2, 0.0)))
        v, origin = self.variable, 0.0
        scale = float(np.abs(v).max())
        if self.sample_time is not None:
            poles, origin, scale = np.exp(poles * self.sample_time), 1.0, 1.0
        columns = [np.ones_like(v), 1.0 / (v - origin) ** 2]
        for pole in poles:
            denominator = (v - pole) * (v - pole.conjugate())
            columns += [1.0 / denominator, v / scale / denominator]
        found = []
        for value, weight in zip(self.values.T, self.weights.T, strict=True):
            basis = np.stack(columns, axis=1) * weight[:, np.newaxis]
            real, wanted = np.vstack([basis.real, basis.imag]), value * weight
            real = real / np.linalg.norm(real, axis=0)
            target = np.concatenate([wanted.real, wanted.imag])
            q, _ = np.linalg.qr(real)
            found.append(target - q @ (q.T @ target))
        return np.concatenate(found)

    def parameters(self, count: int) -> int:
        """Number of parameters with a number of modes."""
        return 2 * count + (2 + 2 * count) * int(self.values.shape[1])


def fitted_modes(
    frequency: RealArray,
    values: NDArray[np.complex128],
    standard_error: RealArray | None,
    sample_time: float | None,
    count: int | None,
) -> tuple[tuple[MeasuredMode, ...], float]:
    """The modes of a response, the lowest first, and the root mean square of the weighted residuals: 1 where the errors explain them.

    Args:
        frequency: (N,) [Hz].
        values: (N, m) the response's elements.
        standard_error: (N, m) of real and of imaginary part; None for errors that are proportional to the magnitude, and as large as
            the residuals say.
        sample_time: of held inputs [s]; None for a continuous response.
        count: number of modes; None for as many as the response shows, at most `MOST`.

    Raises:
        InputError: the response has too few frequencies.
    """
    omega = 2.0 * pi * frequency
    variable = np.asarray(1j * omega if sample_time is None else np.exp(1j * omega * sample_time), complex)
    relative = standard_error is None
    weights = 1.0 / np.maximum(np.abs(values) if standard_error is None else standard_error, 1e-300)
    data = _Data(variable, values, weights, sample_time)
    size = 2 * values.size
    most = MOST if count is None else count
    if count is not None and size <= data.parameters(count):
        raise InputError(
            f"{count} modes have {data.parameters(count)} parameters: {len(frequency)} frequencies are too few for them"
        )

    def criterion(residuals: RealArray, modes: int) -> float:
        # the size of the residuals is one more parameter: they may be larger than the response's errors
        square = max(float(residuals @ residuals), size * EXACT**2)
        return size * log(square / size) + data.parameters(modes) * log(size)

    tried = [[each, log(ratio)] for each in np.linspace(log(omega[0]), log(omega[-1]), STARTS) for ratio in RATIOS]
    found, jacobian, residuals = np.zeros((2, 0)), np.zeros((size, 0)), data.misfit(np.zeros((2, 0)))
    best = criterion(residuals, 0)
    while (n := found.shape[1] + 1) <= most and size > data.parameters(n):
        # another mode where it explains most, then all of them together
        starts = [np.column_stack([found, each]).ravel() for each in tried]
        start = min(starts, key=lambda each: float(np.sum(data.misfit(each) ** 2)))
        lower, upper = (np.repeat(np.log(each), n) for each in ([0.3 * omega[0], 1e-6], [3.0 * omega[-1], 0.99]))
        start = np.clip(start, lower + EXACT, upper - EXACT)
        fit = least_squares(
            data.misfit, start, bounds=(lower, upper), x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12
        )
        now = criterion(fit.fun, n)
        if count is None and now >= best - log(size):
            break
        found, jacobian, residuals, best = fit.x.reshape(2, -1), np.asarray(fit.jac, float), fit.fun, now
        if count is None and np.sqrt(np.mean(residuals**2)) < EXACT:
            break
    # residuals that exceed the response's errors enlarge those of the modes
    scatter = float(np.sqrt(residuals @ residuals / max(size - data.parameters(found.shape[1]), 1)))
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * (scatter if relative else max(scatter, 1.0)) ** 2
    errors = np.sqrt(np.diag(covariance)).reshape(found.shape)
    modes = []
    for k in np.argsort(found[0]).tolist():
        own, names = np.exp(found[:, k]) / (2.0 * pi, 1.0), (("Hz", "Natural frequency"), ("1", "Damping ratio"))
        ends = own[:, np.newaxis] * np.exp(np.minimum(NORMAL * errors[:, k, np.newaxis], UNKNOWN) * [-1.0, 1.0])
        metrics = [
            Metric(value, unit, name=label.lower().replace(" ", "_"), label=label, error=value * error)
            for value, error, (unit, label) in zip(own.tolist(), errors[:, k].tolist(), names, strict=True)
        ]
        modes.append(MeasuredMode(metrics[0], metrics[1], *map(tuple, ends.tolist())))
    return tuple(modes), scatter

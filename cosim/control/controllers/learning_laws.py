"""The laws of iterative learning as weights, and what they make of errors from cycle to cycle.

With w_j(k) and e_j(k) the learned torque and the error of sample k in cycle j, all laws are ::

    w_j+1(k) = sum_i W(i) w_j(k + i) + sum_i E(i) e_j(k + i),      w_0 = 0,      e = reference - measurement

so that on a sampled loop with the response P from learned torques to angles the error of a frequency changes from cycle to cycle by
T = W - P E, the contraction: it shrinks where the largest singular value of T is below 1.

- P-type: W = 1 - forgetting, E a gain at i = shift (S. Arimoto, S. Kawamura, F. Miyazaki, Bettering operation of robots by
  learning, J. Robotic Systems 1 (1984) 123; forgetting: S. Arimoto, Int. J. Control 52 (1990)).
- Norm-optimal: E = (P* P + r)^-1 P*, with which w_j+1 minimises |e_j+1|^2 + r |w_j+1 - w_j|^2 (N. Amann, D. H. Owens, E. Rogers, Iterative
  learning control for discrete-time systems with exponential rate of convergence, IEE Proc. D 143 (1996) 217). P changes along the path
  more slowly than it decays, so E is that of places on the path, interpolated between them.
- A Q-filter multiplies W and E by a low-pass Q without phase (D. A. Bristow, M. Tharayil, A. G. Alleyne, A survey of iterative learning
  control, IEEE Control Systems Magazine 26 (2006) 96): it learns nothing where the model isn't known, and leaves the error there.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log2, pi

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray

ComplexArray = NDArray[np.complex128]

TAIL, FILTER_TAIL = 1e-3, 1e-4
"""Weights of the norm-optimal law and of a Q-filter below this share of the largest one are left out."""

LONGEST_RESPONSE = 1000
"""Largest number of samples of a loop's response that counts."""


@dataclass(frozen=True, eq=False)
class LearningLaw:
    """The weights of the law at the top of this module.

    Attributes:
        torque: W(i) for i = -m .. m, (2 m + 1,).
        error: E(i) for i = ahead - V + 1 .. ahead at S places on the path, equally spaced from its start to its end, (S, V, n, n), for
            learning gains of 1 that multiply its rows.
        ahead: largest i.
        stops: whether errors beyond a cycle's end count as zero; otherwise those of the next cycle follow.
    """

    torque: RealArray
    error: RealArray
    ahead: int
    stops: bool = False

    @property
    def behind(self) -> int:
        """m."""
        return len(self.torque) // 2

    def effects(
        self, response: RealArray, place: float, gain: RealArray, sample_time: float
    ) -> tuple[ComplexArray, ComplexArray, RealArray]:
        """W (F,) and P E (F, n, n) at a place, and frequencies (F,) [Hz], from 0 to half the sampling frequency.

        Args:
            response: P, angles (M, n, n) of the samples after a unit torque of one sample.
            place: where on the path, 0 to 1.
            gain: learning gains (n,).
            sample_time: [s].
        """
        size = _transform_size(LONGEST_RESPONSE, self.error.shape[1], len(self.torque))
        at = np.clip(1.0 - abs(place * (len(self.error) - 1) - np.arange(len(self.error))), 0.0, 1.0)
        error = gain[:, np.newaxis] * np.tensordot(at, self.error, 1)
        # weights are correlated with the future: conjugates, with the phase of their first index
        frequency = np.fft.rfftfreq(size, sample_time)
        turn = np.exp(2j * pi * sample_time * frequency)
        w = np.fft.rfft(self.torque, size).conj() / turn**self.behind
        e = np.fft.rfft(error, size, axis=0).conj() * (turn ** (self.ahead - len(error) + 1))[:, np.newaxis, np.newaxis]
        return w, np.asarray(np.fft.rfft(response, size, axis=0) @ e), np.asarray(frequency)


def proportional_law(shift: int, forgetting: float, q: RealArray, joints: int) -> LearningLaw:
    """The P-type law with a Q-filter's weights q (2 m + 1,), which are (1,) for none."""
    error = q[:, np.newaxis, np.newaxis] * np.eye(joints)
    return LearningLaw((1.0 - forgetting) * q, error[np.newaxis], shift + len(q) // 2, stops=len(q) == 1)


def norm_optimal_law(
    response: RealArray, regularisation: float, forgetting: float, q: RealArray, longest: int
) -> LearningLaw:
    """The norm-optimal law for a response P at S places, (S, M, n, n).

    Args:
        response: angles of the samples after a unit torque of one sample.
        regularisation: r, relative to the largest squared gain of P.
        forgetting: share that is forgotten in each cycle.
        q: weights of the Q-filter, (2 m + 1,).
        longest: largest number of samples that the law looks ahead, and back.
    """
    size = _transform_size(8 * response.shape[1], len(q))
    p = np.fft.rfft(response, size, axis=1)
    r = regularisation * np.linalg.norm(p, 2, axis=(2, 3)).max() ** 2
    adjoint = p.conj().swapaxes(2, 3)
    inverse = np.linalg.solve(adjoint @ p + r * np.eye(p.shape[-1]), adjoint)
    filtered = (
        inverse
        * (np.fft.rfft(q, size) * np.exp(2j * pi * np.arange(size // 2 + 1) / size * (len(q) // 2)))[
            :, np.newaxis, np.newaxis
        ]
    )
    # E(i) is the value at -i of the impulse response, kept as far as it matters
    kernel = np.roll(np.fft.irfft(filtered, size, axis=1)[:, ::-1], 1 + size // 2, axis=1)
    sizes = abs(kernel).max(axis=(0, 2, 3))
    far = abs(np.flatnonzero(sizes > TAIL * sizes.max()) - size // 2).max()
    reach = int(max(1, min(far, longest)))
    return LearningLaw((1.0 - forgetting) * q, kernel[:, size // 2 - reach : size // 2 + reach + 1], reach)


def _transform_size(*lengths: int) -> int:
    """Number of samples of a Fourier transform, a power of 2 with eight frequencies within the width of a resonance."""
    return int(max(4096, 2 ** int(np.ceil(log2(8 * max(lengths))))))


def zero_phase(cut_off: float | None, sample_time: float, longest: int) -> RealArray:
    """Weights (2 m + 1,) of a Butterworth low-pass of second order, forward and backward: 1 / (1 + (f / cut-off)^4) without phase.

    Args:
        cut_off: where half of the amplitude is left [Hz]; None for no filter.
        sample_time: [s].
        longest: largest m.

    Raises:
        InputError: the cut-off isn't below half the sampling frequency, or is too low for a cycle.
    """
    if cut_off is None:
        return np.ones(1)
    if not 0.0 < cut_off * sample_time < 0.5:
        raise InputError(
            f"the Q-filter's cut-off must be below half the sampling frequency of {1.0 / sample_time:g} Hz, got {cut_off:g} Hz"
        )
    size = 2 ** int(np.ceil(log2(max(4096.0, 16.0 / (cut_off * sample_time)))))
    # bilinear transform with the cut-off in its place
    with np.errstate(over="ignore"):
        ratio = np.tan(pi * np.arange(size // 2) / size) / np.tan(pi * cut_off * sample_time)
        gains = 1.0 / (1.0 + np.append(ratio, np.inf) ** 4)
    kernel = np.fft.irfft(gains)
    m = int(np.flatnonzero(abs(kernel[: size // 2]) > FILTER_TAIL * kernel[0]).max())
    if m > longest:
        raise InputError(
            f"the Q-filter's cut-off of {cut_off:g} Hz needs {m} samples before and after each, and a cycle leaves {longest}: raise it"
        )
    taps = np.concatenate([kernel[m:0:-1], kernel[: m + 1]])
    return np.asarray(taps / taps.sum())

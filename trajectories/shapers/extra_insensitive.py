"""Extra-insensitive shapers: EI, two-hump, three-hump and more humps, with a tolerable residual over a wide frequency range.

The residual of the undamped n-hump shaper is the Chebyshev polynomial of degree n + 1, as for Dolph's antenna arrays (1946).
It has the widest frequency range for n + 2 impulses half a period apart and a given tolerance. For one, two and three humps it
agrees with the closed forms of the literature:

- Singhose, Seering and Singer, "Residual Vibration Reduction Using Vector Diagrams to Generate Shaped Inputs",
  J. Mech. Des. 116, 1994 (EI);
- Singhose, Porter, Tuttle and Singer, "Vibration Reduction Using Multi-Hump Input Shapers", J. Dyn. Syst. Meas. Control
  119, 1997, and Singhose, Crain and Seering, "Convolved and Simultaneous Two-Mode Input Shapers", IEE Proc. Control Theory
  Appl. 144, 1997 (two and three humps).

With damping the conditions are the same: zero residual at n + 1 frequencies, and n humps between them that reach the tolerance
exactly. They are solved by continuation in the damping ratio from the undamped solution. The middle zero (n even) or the top
of the middle hump (n odd) is at the design frequency. For two humps, the published polynomials in ζ for 5 % approximate this
solution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator, checked_fraction

MOST_HUMPS = 8
"""Largest number of humps, up to which the damped equations have been tested; such a shaper lasts nine half periods."""

CONTINUATION_STEP = 0.02
"""Step of the damping ratio in the continuation."""

SOLVED = 1e-9
"""Largest residual of the equations of a solution."""


def extra_insensitive(mode: Oscillator, tolerance: float = 0.05, humps: int = 1) -> ImpulseSequence:
    """Design an EI shaper with one or more humps.

    Args:
        mode: the vibration mode to suppress.
        tolerance: admissible residual V, 0 to 1 exclusive; the humps reach it.
        humps: 1 for EI, 2 and 3 for two-hump and three-hump EI, at most 8.

    Raises:
        TrajectoryError: an argument is out of range, or the damping is too high for a sequence of this kind.
    """
    from scipy.optimize import root  # here, since most motions need no scipy

    checked_fraction("tolerable residual", tolerance)
    if not 1 <= humps <= MOST_HUMPS:
        raise TrajectoryError(f"number of humps must be 1 to {MOST_HUMPS}, got {humps}")
    # continuation from the undamped solution, in small steps of the damping ratio
    conditions = _Conditions(humps, tolerance)
    unknowns = conditions.undamped()
    steps = math.ceil(mode.ratio / CONTINUATION_STEP)
    for ratio in np.linspace(0.0, mode.ratio, steps + 1)[1:]:
        found = root(conditions.equations, unknowns, args=(float(ratio),), tol=1e-14)
        unknowns = np.asarray(found.x)
        # detect another root by unordered unknowns, no root by the residual
        _, *ordered = conditions.unpack(unknowns)
        ascending = all(np.all(np.diff(values) > 0.0) for values in ordered)
        if np.max(np.abs(conditions.equations(unknowns, float(ratio)))) > SOLVED or not ascending:
            raise TrajectoryError(
                f"no EI shaper with {humps} hump(s) exists near a damping ratio of {ratio:.3g}: "
                "use fewer humps, ZVD or ZV; the vibration decays quickly"
            )
    # from angles ω0 t to times
    amplitudes, angles, _, _ = conditions.unpack(unknowns)
    return ImpulseSequence(tuple(angles / mode.angular_frequency), tuple(amplitudes))


def chebyshev_amplitudes(impulses: int, tolerance: float) -> RealArray:
    """Return the amplitudes (N,) of N equidistant impulses whose residual V T_{N-1}(x0 cos(θ/2)) ripples between ±V.

    T is the Chebyshev polynomial, x0 = cosh(acosh(1/V) / (N - 1)), θ the phase between two impulses, V the tolerance. An inverse
    discrete Fourier transform gives the amplitudes; N points suffice for a polynomial of degree N - 1.
    """
    degree = impulses - 1
    phases = 2.0 * np.pi * np.arange(impulses) / impulses
    response = tolerance * np.polynomial.chebyshev.Chebyshev.basis(degree)(
        _chebyshev_edge(impulses, tolerance) * np.cos(0.5 * phases)
    )
    # inverse transform, with the impulses numbered from the middle
    places = np.arange(impulses) - 0.5 * degree
    return np.asarray(np.cos(np.outer(places, phases)) @ response / impulses)


def _chebyshev_edge(impulses: int, tolerance: float) -> float:
    """Return x0 of `chebyshev_amplitudes`."""
    return math.cosh(math.acosh(1.0 / tolerance) / (impulses - 1))


@dataclass(frozen=True)
class _Conditions:
    """The 4 n + 2 conditions of an n-hump shaper, in angles ω0 t and frequencies ω/ω0.

    The unknowns are the amplitudes without the first, the angles without the first, and the frequencies of zeros and humps' tops
    without the middle one, which is 1.
    """

    humps: int
    tolerance: float

    @property
    def impulses(self) -> int:
        return self.humps + 2

    def undamped(self) -> RealArray:
        """Return the unknowns of the undamped solution, in closed form."""
        # zeros and extrema of the Chebyshev polynomial, as frequencies
        n, edge = self.humps + 1, _chebyshev_edge(self.impulses, self.tolerance)
        zeros = 2.0 / np.pi * np.arccos(np.cos(np.pi * (2 * np.arange(n) + 1) / (2 * n)) / edge)
        tops = 2.0 / np.pi * np.arccos(np.cos(np.pi * np.arange(1, n) / n) / edge)
        amplitudes = chebyshev_amplitudes(self.impulses, self.tolerance)
        # the middle one is at the design frequency, hence no unknown
        fixed, free = (tops, zeros) if self.humps % 2 else (zeros, tops)
        moving = np.delete(fixed, self.humps // 2)
        frequencies = [free, moving] if self.humps % 2 else [moving, free]
        return np.concatenate([amplitudes[1:], np.pi * np.arange(1, self.impulses), *frequencies])

    def unpack(self, unknowns: RealArray) -> tuple[RealArray, RealArray, RealArray, RealArray]:
        """Return amplitudes (n + 2,), angles (n + 2,), frequencies of the zeros (n + 1,) and of the humps' tops (n,)."""
        # amplitudes add up to 1, the first angle is 0, the frequency in the middle is 1
        n = self.humps + 1
        amplitudes = np.concatenate([[1.0 - np.sum(unknowns[:n])], unknowns[:n]])
        angles = np.concatenate([[0.0], unknowns[n : 2 * n]])
        rest = unknowns[2 * n :]
        if self.humps % 2:
            return amplitudes, angles, rest[:n], np.insert(rest[n:], self.humps // 2, 1.0)
        return amplitudes, angles, np.insert(rest[: n - 1], self.humps // 2, 1.0), rest[n - 1 :]

    def equations(self, unknowns: RealArray, ratio: float) -> RealArray:
        """Return the residuals (4 n + 2,): response at the zeros; at the tops, deviation from the tolerance, and slope."""
        amplitudes, angles, zeros, tops = self.unpack(unknowns)
        # decay relative to the last impulse; differentiation by the frequency multiplies each exponential by its exponent
        exponents = complex(ratio, math.sqrt(1.0 - ratio**2)) * angles - ratio * angles[-1]
        at_zeros = np.exp(np.outer(zeros, exponents)) @ amplitudes
        waves = np.exp(np.outer(tops, exponents))
        at_tops, slopes = waves @ amplitudes, waves @ (amplitudes * exponents)
        return np.concatenate(
            [
                at_zeros.real,
                at_zeros.imag,
                np.abs(at_tops) / self.tolerance - 1.0,
                (np.conj(at_tops) * slopes).real / (self.tolerance**2 * angles[-1]),
            ]
        )

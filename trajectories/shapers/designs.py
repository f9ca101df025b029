"""Designs of input shapers: ZV, ZVD, ... and MZV, UM-ZV, EI with any number of humps, and specified insensitivity.

ZV, ZVD, ZVDD, ... and MZV have equidistant impulses: the undamped amplitudes times K^i, with K the decay from one impulse to the
next, cancel the damped oscillator exactly.

The residual of the undamped n-hump EI shaper is the Chebyshev polynomial of degree n + 1, as for Dolph's antenna arrays (1946).
It has the widest frequency range for n + 2 impulses half a period apart and a given tolerance. For one, two and three humps it
agrees with the closed forms of the literature:

- Singhose, Seering and Singer, "Residual Vibration Reduction Using Vector Diagrams to Generate Shaped Inputs",
  J. Mech. Des. 116, 1994 (EI);
- Singhose, Porter, Tuttle and Singer, "Vibration Reduction Using Multi-Hump Input Shapers", J. Dyn. Syst. Meas. Control
  119, 1997, and Singhose, Crain and Seering, "Convolved and Simultaneous Two-Mode Input Shapers", IEE Proc. Control Theory
  Appl. 144, 1997 (two and three humps).

With damping, UM-ZV and EI shapers satisfy the same conditions; they are solved by continuation in the damping ratio from the
undamped solution.

Specified-insensitivity shapers are found by optimisation over frequency samples (Singhose, Seering and Singer, "Input Shaping for
Vibration Reduction with Specified Insensitivity to Modeling Errors", Japan-USA Symposium on Flexible Automation, 1996; Vaughan, Yano
and Singhose, "Comparison of Robust Input Shapers", J. Sound and Vibration 315, 2008).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator, checked_fraction, checked_ratio

HIGHEST_DERIVATIVES = 20
"""Largest number of zero derivatives; the last impulse is 10.5 periods after the first."""

MOST_HUMPS = 8
"""Largest number of humps, up to which the damped equations have been tested; such a shaper lasts nine half periods."""

CONTINUATION_STEP = 0.02
"""Step of the damping ratio in the continuation from the undamped solution."""

SOLVED = 1e-9
"""Largest residual of the equations of a solution."""

MOST_IMPULSES = 10
"""Largest number of impulses of specified insensitivity; enough for a range from half to twice a frequency at 5 %."""

SAMPLES_PER_IMPULSE = 40
"""Frequency samples per impulse during the optimisation; a hump of the residual spans about so many."""

DENSITY = 10
"""Factor by which the final check has more frequency samples than the optimisation."""

EXCESS = 1e-3
"""Accepted excess of the residual over the tolerance between the samples, relative to the tolerance."""

SMALLEST_GAP = 0.05
"""Smallest distance of two impulses, in periods of the middle frequency."""


def zero_vibration(mode: Oscillator, derivatives: int = 0) -> ImpulseSequence:
    """Design a ZV, ZVD, ZVDD, ... shaper; each D makes one more derivative of the residual zero at the design frequency.

    Impulses at 0, T_d/2, T_d, ... with binomial coefficients times K^i, K = exp(-ζπ / sqrt(1 - ζ²)) (Singer and Seering,
    "Preshaping Command Inputs to Reduce System Vibration", J. Dyn. Syst. Meas. Control 112, 1990).

    Args:
        mode: the vibration mode to cancel.
        derivatives: number of zero derivatives: 0 for ZV, 1 for ZVD, 2 for ZVDD, up to 20.

    Raises:
        TrajectoryError: the number of derivatives is out of range.
    """
    if not 0 <= derivatives <= HIGHEST_DERIVATIVES:
        raise TrajectoryError(f"number of zero derivatives must be 0 to {HIGHEST_DERIVATIVES}, got {derivatives}")
    impulses = derivatives + 2
    return _equidistant(mode, 0.5 * mode.damped_period, [math.comb(impulses - 1, i) for i in range(impulses)])


def modified_zero_vibration(mode: Oscillator) -> ImpulseSequence:
    """Design an MZV shaper: three impulses 3/8 of a period apart, shorter than ZVD and less sensitive than ZV.

    Undamped amplitudes (1 - 1/√2, √2 - 1, 1 - 1/√2), as in the Klipper firmware for 3D printers, where it comes from
    (Klipper3d/klipper, klippy/extras/shaper_defs.py).
    """
    outer = 1.0 - math.sqrt(0.5)
    return _equidistant(mode, 0.375 * mode.damped_period, [outer, math.sqrt(2.0) - 1.0, outer])


def _equidistant(mode: Oscillator, spacing: float, undamped: list[float]) -> ImpulseSequence:
    """Return impulses ``spacing`` [s] apart, with amplitudes proportional to the undamped ones times the decay."""
    weights = [amplitude * mode.decay(i * spacing) for i, amplitude in enumerate(undamped)]
    # the sum is 1, so that the motion keeps its end point
    total = math.fsum(weights)
    return ImpulseSequence(tuple(i * spacing for i in range(len(weights))), tuple(w / total for w in weights))


def unity_magnitude(mode: Oscillator) -> ImpulseSequence:
    """Design a UM-ZV shaper: impulses 1, -1, 1 within a third of a period, the shortest of all; it excites high modes.

    Undamped at 0, T/6, T/3 (Singhose, Singer and Seering, "Time-Optimal Negative Input Shapers", J. Dyn. Syst. Meas.
    Control 119, 1997). The damped times solve the two equations of zero vibration exactly instead of by that paper's
    polynomials in ζ, whose error is up to 2e-3 of a period.

    Raises:
        TrajectoryError: there is no such shaper for this damping ratio.
    """

    def equations(angles: RealArray, ratio: float) -> RealArray:
        """Real and imaginary part of (1 - exp(p θ1) + exp(p θ2)) exp(-ζ θ2), with p = ζ + j sqrt(1 - ζ²)."""
        pole = complex(ratio, math.sqrt(1.0 - ratio**2))
        first, second = np.exp(pole * angles)
        total = (1.0 - first + second) * math.exp(-ratio * angles[1])
        return np.array([total.real, total.imag])

    undamped = np.array([np.pi / 3.0, 2.0 * np.pi / 3.0])
    angles = _continued(equations, undamped, mode, lambda found: [np.insert(found, 0, 0.0)], "UM-ZV shaper", "ZV")
    first, second = (angles / mode.angular_frequency).tolist()
    return ImpulseSequence((0.0, first, second), (1.0, -1.0, 1.0))


def extra_insensitive(mode: Oscillator, tolerance: float = 0.05, humps: int = 1) -> ImpulseSequence:
    """Design an EI shaper with one or more humps, for a tolerable residual over a wide frequency range.

    The conditions are zero residual at n + 1 frequencies, and n humps between them that reach the tolerance exactly. The middle zero
    (n even) or the top of the middle hump (n odd) is at the design frequency. For two humps, the published polynomials in ζ for 5 %
    approximate this solution.

    Args:
        mode: the vibration mode to suppress.
        tolerance: admissible residual V, 0 to 1 exclusive; the humps reach it.
        humps: 1 for EI, 2 and 3 for two-hump and three-hump EI, at most 8.

    Raises:
        TrajectoryError: an argument is out of range, or the damping is too high for a sequence of this kind.
    """
    checked_fraction("tolerable residual", tolerance)
    if not 1 <= humps <= MOST_HUMPS:
        raise TrajectoryError(f"number of humps must be 1 to {MOST_HUMPS}, got {humps}")
    n, middle, top_in_middle = humps + 1, humps // 2, humps % 2 == 1

    # unknowns: amplitudes and angles ω0 t without the first, frequencies ω/ω0 of zeros and humps' tops without the middle one
    def unpack(unknowns: RealArray) -> tuple[RealArray, RealArray, RealArray, RealArray]:
        """Amplitudes (n + 1,), which add up to 1, angles (n + 1,), frequencies of the zeros (n,) and of the tops (n - 1,)."""
        amplitudes = np.concatenate([[1.0 - np.sum(unknowns[:n])], unknowns[:n]])
        angles = np.concatenate([[0.0], unknowns[n : 2 * n]])
        zeros, tops = np.split(unknowns[2 * n :], [n if top_in_middle else n - 1])
        if top_in_middle:
            return amplitudes, angles, zeros, np.insert(tops, middle, 1.0)
        return amplitudes, angles, np.insert(zeros, middle, 1.0), tops

    def equations(unknowns: RealArray, ratio: float) -> RealArray:
        """Response at the zeros; at the tops, deviation from the tolerance, and slope, (4 n - 2,)."""
        amplitudes, angles, zeros, tops = unpack(unknowns)
        # decay relative to the last impulse; differentiation by the frequency multiplies each exponential by its exponent
        exponents = complex(ratio, math.sqrt(1.0 - ratio**2)) * angles - ratio * angles[-1]
        at_zeros = np.exp(np.outer(zeros, exponents)) @ amplitudes
        waves = np.exp(np.outer(tops, exponents))
        at_tops, slopes = waves @ amplitudes, waves @ (amplitudes * exponents)
        excess = np.abs(at_tops) / tolerance - 1.0
        turning = (np.conj(at_tops) * slopes).real / (tolerance**2 * angles[-1])
        return np.concatenate([at_zeros.real, at_zeros.imag, excess, turning])

    # undamped: zeros and extrema of the Chebyshev polynomial, as frequencies
    edge = _chebyshev_edge(n + 1, tolerance)
    zeros = 2.0 / np.pi * np.arccos(np.cos(np.pi * (2 * np.arange(n) + 1) / (2 * n)) / edge)
    tops = 2.0 / np.pi * np.arccos(np.cos(np.pi * np.arange(1, n) / n) / edge)
    free = [zeros, np.delete(tops, middle)] if top_in_middle else [np.delete(zeros, middle), tops]
    undamped = np.concatenate([chebyshev_amplitudes(n + 1, tolerance)[1:], np.pi * np.arange(1, n + 1), *free])
    name = f"EI shaper with {humps} hump(s)"
    found = _continued(equations, undamped, mode, lambda each: unpack(each)[1:], name, "fewer humps, ZVD or ZV")
    amplitudes, angles, _, _ = unpack(found)
    return ImpulseSequence(tuple(angles / mode.angular_frequency), tuple(amplitudes))


def _continued(
    equations: Callable[[RealArray, float], RealArray],
    undamped: RealArray,
    mode: Oscillator,
    ascending: Callable[[RealArray], Sequence[RealArray]],
    name: str,
    others: str,
) -> RealArray:
    """Return the solution of a shaper's equations at a mode's damping, by continuation from the undamped one.

    Args:
        equations: (unknowns, damping ratio) → residuals.
        undamped: the unknowns without damping.
        mode: the mode.
        ascending: unknowns → the parts of them that ascend in a valid solution.
        name, others: the shaper, and what to use instead, for the message.

    Raises:
        TrajectoryError: there is no solution.
    """
    from scipy.optimize import root  # here, since most motions need no scipy

    unknowns = undamped
    for ratio in np.linspace(0.0, mode.ratio, math.ceil(mode.ratio / CONTINUATION_STEP) + 1)[1:].tolist():
        unknowns = np.asarray(root(equations, unknowns, args=(ratio,), tol=1e-14).x)
        # another root shows in unordered unknowns, no root in the residual
        ordered = all(np.all(np.diff(part) > 0.0) for part in ascending(unknowns))
        if np.max(np.abs(equations(unknowns, ratio))) > SOLVED or not ordered:
            raise TrajectoryError(
                f"no {name} exists near a damping ratio of {ratio:.3g}: use {others}; the vibration decays quickly"
            )
    return unknowns


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


def specified_insensitivity(
    lowest: float, highest: float, tolerance: float = 0.05, ratio: float = 0.0
) -> ImpulseSequence:
    """Design the shortest sequence of positive impulses whose residual is at most a tolerance over a frequency range.

    Args:
        lowest, highest: the range of the natural frequency [Hz].
        tolerance: admissible residual, 0 to 1 exclusive.
        ratio: damping ratio ζ, the same over the whole range.

    Raises:
        TrajectoryError: an argument is out of range, or ten impulses don't suffice.
    """
    positive("lowest frequency", lowest, "Hz")
    if not (math.isfinite(highest) and highest >= lowest):
        raise TrajectoryError(f"highest frequency must be at least the lowest, {lowest:g} Hz, got {highest:g} Hz")
    checked_fraction("tolerable residual", tolerance)
    checked_ratio(ratio)
    # add impulses until the residual is tolerable over the whole range, checked on more samples than in the optimisation
    middle = 0.5 * (lowest + highest)
    ends = lowest / middle, highest / middle
    for impulses in range(2, MOST_IMPULSES + 1):
        amplitudes, periods = _shortest(impulses, *ends, tolerance, ratio)
        frequencies = np.linspace(*ends, DENSITY * SAMPLES_PER_IMPULSE * impulses)
        worst = float(np.sqrt(np.max(_squares(amplitudes, periods, frequencies, ratio)[0])))
        if worst <= tolerance * (1.0 + EXCESS):
            return ImpulseSequence(tuple(periods / middle), tuple(amplitudes / np.sum(amplitudes)))
    raise TrajectoryError(
        f"no sequence of {MOST_IMPULSES} impulses keeps the residual at {tolerance:g} from {lowest:g} to {highest:g} Hz "
        f"with a damping ratio of {ratio:g}: choose a narrower range or a larger tolerance"
    )


def _shortest(
    impulses: int, lowest: float, highest: float, tolerance: float, ratio: float
) -> tuple[RealArray, RealArray]:
    """Return amplitudes and times (N,), in units of the middle frequency and its period, with the earliest last impulse.

    With too few impulses the residual exceeds the tolerance.
    """
    from scipy.optimize import Bounds, minimize  # here, since most motions need no scipy

    n, samples = impulses, np.linspace(lowest, highest, SAMPLES_PER_IMPULSE * impulses)

    def unpack(x: RealArray) -> tuple[RealArray, RealArray]:
        return x[:n], np.concatenate([[0.0], x[n:]])

    def margins(x: RealArray) -> tuple[RealArray, RealArray]:
        """1 - (residual / tolerance)² at M samples (M,), and its Jacobian by the unknowns (M, 2 N - 1)."""
        squares, by_amplitudes, by_times = _squares(*unpack(x), samples, ratio)
        slopes = -np.hstack([by_amplitudes, by_times[:, 1:]]) / tolerance**2
        return np.asarray(1.0 - squares / tolerance**2), np.asarray(slopes)

    # unknowns: all amplitudes, and all times but the first; goal, bounds, order and sum are linear in them
    goal, total = np.zeros(2 * n - 1), np.concatenate([np.ones(n), np.zeros(n - 1)])
    goal[-1] = 1.0
    order = np.hstack([np.zeros((n - 1, n)), np.eye(n - 1) - np.eye(n - 1, k=-1)])
    arguments: dict[str, Any] = {
        "method": "SLSQP",
        "jac": lambda x: goal,
        "bounds": Bounds(np.zeros(2 * n - 1), np.r_[np.ones(n), np.full(n - 1, np.inf)]),
        "constraints": [
            {"type": "ineq", "fun": lambda x: margins(x)[0], "jac": lambda x: margins(x)[1]},
            {"type": "ineq", "fun": lambda x: order @ x - SMALLEST_GAP, "jac": lambda x: order},
            {"type": "eq", "fun": lambda x: x @ total - 1.0, "jac": lambda x: total},
        ],
        "options": {"maxiter": 500, "ftol": 1e-12},
    }

    def last_time(x: RealArray) -> float:
        return float(x[-1])

    # start from the Chebyshev sequence of this number of impulses, half a period apart
    times = 0.5 * np.arange(n)
    amplitudes = chebyshev_amplitudes(n, tolerance) * np.exp(-2.0 * np.pi * ratio * times)
    found = minimize(last_time, np.concatenate([amplitudes / np.sum(amplitudes), times[1:]]), **arguments)
    return unpack(np.asarray(found.x))


def _squares(
    amplitudes: RealArray, times: RealArray, frequencies: RealArray, ratio: float
) -> tuple[RealArray, RealArray, RealArray]:
    """Return squared residuals (M,) after the latest impulse, and their Jacobians by amplitudes and times, (M, N) each."""
    # decay relative to the latest impulse, so that no exponent has a positive real part
    latest = int(np.argmax(times))  # iterates may have impulses out of order
    omega = 2.0 * np.pi * frequencies
    pole = complex(ratio, math.sqrt(1.0 - ratio**2))
    waves = np.exp(np.outer(omega, pole * times - ratio * times[latest]))
    # |Σ A_i w_i|² and its derivatives; all w_i depend on the latest time
    response = waves @ amplitudes
    squares = np.abs(response) ** 2
    by_amplitudes = 2.0 * (np.conj(response)[:, None] * waves).real
    by_times = 2.0 * (np.conj(response)[:, None] * waves * (pole * omega)[:, None] * amplitudes).real
    by_times[:, latest] -= 2.0 * ratio * omega * squares
    return squares, by_amplitudes, by_times


SHAPERS: Mapping[str, Callable[[Oscillator], ImpulseSequence]] = {
    "um-zv": unity_magnitude,
    "zv": zero_vibration,
    "mzv": modified_zero_vibration,
    "zvd": lambda mode: zero_vibration(mode, 1),
    "ei": lambda mode: extra_insensitive(mode, humps=1),
    "zvdd": lambda mode: zero_vibration(mode, 2),
    "2-hump-ei": lambda mode: extra_insensitive(mode, humps=2),
    "zvddd": lambda mode: zero_vibration(mode, 3),
    "3-hump-ei": lambda mode: extra_insensitive(mode, humps=3),
}
"""Name in scene files and tables → shaper for one mode, the shortest first; the tolerance of EI shapers is 5 %."""


def design(name: str, modes: Sequence[Oscillator]) -> ImpulseSequence:
    """Design one of `SHAPERS`; for several modes, the sequences for each mode are convolved.

    Args:
        name: key of `SHAPERS`.
        modes: vibration modes to suppress, at least one.

    Raises:
        TrajectoryError: there is no such name, there is no mode, or no such shaper exists for a mode.
    """
    if name not in SHAPERS:
        raise TrajectoryError(f"shaper must be one of {', '.join(SHAPERS)}; got {name!r}")
    if not modes:
        raise TrajectoryError(f"shaper {name} needs at least one vibration mode to act against")
    return reduce(ImpulseSequence.convolve, (SHAPERS[name](mode) for mode in modes))

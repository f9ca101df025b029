"""Shapers without residual vibration at the design frequency: ZV, ZVD, ZVDD and higher orders, MZV, and UM-ZV.

For equidistant impulses, the undamped amplitudes times K^i, with K the decay from one impulse to the next, cancel the damped
oscillator exactly.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator

HIGHEST_DERIVATIVES = 20
"""Largest order; its last impulse is 10.5 periods after the first."""

CONTINUATION_STEP = 0.02
"""Step of the damping ratio in the continuation from the undamped solution."""

CANCELLED = 1e-12
"""Largest residual of the equations of a solution."""


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


def unity_magnitude(mode: Oscillator) -> ImpulseSequence:
    """Design a UM-ZV shaper: impulses 1, -1, 1 within a third of a period, the shortest of all; it excites high modes.

    Undamped at 0, T/6, T/3 (Singhose, Singer and Seering, "Time-Optimal Negative Input Shapers", J. Dyn. Syst. Meas.
    Control 119, 1997). The damped times solve the two equations of zero vibration exactly instead of by that paper's
    polynomials in ζ, whose error is up to 2e-3 of a period.

    Raises:
        TrajectoryError: there is no such shaper for this damping ratio.
    """
    from scipy.optimize import root  # here, since most motions need no scipy

    # continuation from the undamped angles, in small steps of the damping ratio
    angles = np.array([np.pi / 3.0, 2.0 * np.pi / 3.0])
    for ratio in np.linspace(0.0, mode.ratio, math.ceil(mode.ratio / CONTINUATION_STEP) + 1):
        found = root(_unity_magnitude_equations, angles, args=(float(ratio),), tol=1e-14)
        angles = found.x
    # detect another root by unordered angles, no root by the residual
    cancelled = np.max(np.abs(_unity_magnitude_equations(angles, mode.ratio))) <= CANCELLED
    if not (cancelled and 0.0 < angles[0] < angles[1]):
        raise TrajectoryError(f"no UM-ZV shaper was found for a damping ratio of {mode.ratio:g}: use ZV")
    first, second = (float(angle) / mode.angular_frequency for angle in angles)
    return ImpulseSequence((0.0, first, second), (1.0, -1.0, 1.0))


def _unity_magnitude_equations(angles: RealArray, ratio: float) -> RealArray:
    """Return real and imaginary part of (1 - exp(p θ1) + exp(p θ2)) exp(-ζ θ2), with p = ζ + j sqrt(1 - ζ²)."""
    pole = complex(ratio, math.sqrt(1.0 - ratio**2))
    total = (1.0 - cmath.exp(pole * angles[0]) + cmath.exp(pole * angles[1])) * math.exp(-ratio * angles[1])
    return np.array([total.real, total.imag])


def _equidistant(mode: Oscillator, spacing: float, undamped: list[float]) -> ImpulseSequence:
    """Return impulses ``spacing`` [s] apart, with amplitudes proportional to the undamped ones times the decay."""
    weights = [amplitude * mode.decay(i * spacing) for i, amplitude in enumerate(undamped)]
    # the sum is 1, so that the motion keeps its end point
    total = math.fsum(weights)
    return ImpulseSequence(tuple(i * spacing for i in range(len(weights))), tuple(w / total for w in weights))

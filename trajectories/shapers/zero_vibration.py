"""Shapers that leave no vibration at the design frequency: ZV, ZVD, ZVDD and further, MZV, and UM-ZV.

Impulses at equal distances whose amplitudes follow the undamped ones times K^i, K being the decay over that distance,
cancel a damped oscillator as exactly as the undamped ones an undamped one.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
from scipy.optimize import root

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator

HIGHEST_DERIVATIVES = 20
"""Largest order: the last impulse comes ten periods late."""

CONTINUATION_STEP = 0.02
"""Step of the damping ratio in which a solution is followed from the undamped one."""

CANCELLED = 1e-12
"""Residual that counts as zero when equations are solved by iteration."""


def zero_vibration(mode: Oscillator, derivatives: int = 0) -> ImpulseSequence:
    """ZV, and ZVD, ZVDD, ... with one more derivative of the residual by the frequency zero at the design frequency.

    Impulses at 0, T_d/2, T_d, ... with binomial coefficients times K^i, K = exp(-ζπ / sqrt(1 - ζ²)) (Singer and Seering,
    "Preshaping Command Inputs to Reduce System Vibration", J. Dyn. Syst. Meas. Control 112, 1990).

    Args:
        mode: what to cancel.
        derivatives: 0 for ZV, 1 for ZVD, 2 for ZVDD, and so on to 20.
    """
    if not 0 <= derivatives <= HIGHEST_DERIVATIVES:
        raise TrajectoryError(f"number of zero derivatives must be 0 to {HIGHEST_DERIVATIVES}, got {derivatives}")
    impulses = derivatives + 2
    return _equidistant(mode, 0.5 * mode.damped_period, [math.comb(impulses - 1, i) for i in range(impulses)])


def modified_zero_vibration(mode: Oscillator) -> ImpulseSequence:
    """MZV: three impulses 3/8 of a period apart, shorter than ZVD and less sensitive than ZV.

    Undamped amplitudes (1 - 1/√2, √2 - 1, 1 - 1/√2), as in the Klipper firmware for 3D printers, where it comes from
    (Klipper3d/klipper, klippy/extras/shaper_defs.py).
    """
    outer = 1.0 - math.sqrt(0.5)
    return _equidistant(mode, 0.375 * mode.damped_period, [outer, math.sqrt(2.0) - 1.0, outer])


def unity_magnitude(mode: Oscillator) -> ImpulseSequence:
    """UM-ZV: impulses 1, -1, 1, the shortest of all at a third of a period; it excites high modes.

    Undamped at 0, T/6, T/3 (Singhose, Singer and Seering, "Time-Optimal Negative Input Shapers", J. Dyn. Syst. Meas.
    Control 119, 1997). The damped times solve the two equations of zero vibration exactly instead of by that paper's
    polynomials in ζ, which are good to 2e-3 of a period.
    """
    # the undamped angles, followed in small steps of the damping ratio
    angles = np.array([np.pi / 3.0, 2.0 * np.pi / 3.0])
    for ratio in np.linspace(0.0, mode.ratio, math.ceil(mode.ratio / CONTINUATION_STEP) + 1):
        found = root(_unity_magnitude_equations, angles, args=(float(ratio),), tol=1e-14)
        angles = found.x
    # another root of the equations, or none, shows by its order or its residual
    cancelled = np.max(np.abs(_unity_magnitude_equations(angles, mode.ratio))) <= CANCELLED
    if not (cancelled and 0.0 < angles[0] < angles[1]):
        raise TrajectoryError(f"no UM-ZV shaper was found for a damping ratio of {mode.ratio:g}: use ZV")
    first, second = (float(angle) / mode.angular_frequency for angle in angles)
    return ImpulseSequence((0.0, first, second), (1.0, -1.0, 1.0))


def _unity_magnitude_equations(angles: RealArray, ratio: float) -> RealArray:
    """Real and imaginary part of 1 - exp(p θ1) + exp(p θ2), p = ζ + j sqrt(1 - ζ²), scaled to the last impulse."""
    pole = complex(ratio, math.sqrt(1.0 - ratio**2))
    total = (1.0 - cmath.exp(pole * angles[0]) + cmath.exp(pole * angles[1])) * math.exp(-ratio * angles[1])
    return np.array([total.real, total.imag])


def _equidistant(mode: Oscillator, spacing: float, undamped: list[float]) -> ImpulseSequence:
    """Impulses ``spacing`` [s] apart with amplitudes in proportion to the undamped ones times the decay."""
    weights = [amplitude * mode.decay(i * spacing) for i, amplitude in enumerate(undamped)]
    # the sum is 1, so that the motion keeps its end
    total = math.fsum(weights)
    return ImpulseSequence(tuple(i * spacing for i in range(len(weights))), tuple(w / total for w in weights))

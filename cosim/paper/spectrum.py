"""Power spectral density of the joint accelerations of a motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

from flexfmu.trajectories.trajectory import Trajectory

SAMPLING_FREQUENCY = 20_000.0
"""Samples per second: 100 times the highest frequency shown, so that folded parts of a jump stay 1e-4 below."""

WINDOW = 4.0
"""Length of the window [s]: the motion, then standstill; the same for all motions, so that densities compare."""

Series = NDArray[np.float64]


def acceleration_spectrum(joints: Trajectory, joint: int) -> tuple[Series, Series]:
    """One-sided power spectral density of a joint's acceleration, and its frequencies.

    The signal is the motion followed by standstill, over a window of `WINDOW` seconds. It is zero at both ends of the
    window, so no taper is applied, and its mean is not removed. The integral of the density over the frequency is the
    mean square of the acceleration over the window. All motions share the window, so densities compare as energies.

    Args:
        joints: joint trajectory [rad].
        joint: 0 for q11, 1 for q21.

    Returns:
        Frequencies [Hz] in steps of 1 / `WINDOW`, and densities [(rad/s²)²/Hz].
    """
    time = np.arange(round(WINDOW * SAMPLING_FREQUENCY)) / SAMPLING_FREQUENCY
    acceleration = joints.evaluate(time, order=2)[2, :, joint]
    frequency, density = periodogram(
        acceleration, SAMPLING_FREQUENCY, window="boxcar", detrend=False, scaling="density"
    )
    return frequency, density


def band_average(frequency: Series, density: Series, width: float) -> Series:
    """Mean of the density over a band of ``width`` [Hz] around each frequency; narrower at the ends.

    A motion with jumps has a comb of lobes 1 / duration apart; the mean over several lobes is what a resonance sees
    whose frequency isn't known to a fraction of a hertz.
    """
    half = max(1, round(0.5 * width / (frequency[1] - frequency[0])))
    total = np.concatenate([[0.0], np.cumsum(density)])
    index = np.arange(density.size)
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, density.size)
    return np.asarray((total[last] - total[first]) / (last - first))

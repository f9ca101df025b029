"""Amplitude spectra of what rings after a motion: Fourier transform with a Hann window, zeros appended to `PADDING` times the length.

A harmonic of amplitude A that lasts gives a peak of height A (F. J. Harris, On the use of windows for harmonic analysis with the
discrete Fourier transform, Proc. IEEE 66, 1978); one that decays gives less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.reports.chart import Curve, Marker, Panel

PADDING = 4
"""Length of the transform in terms of the signal's: the peak is met within 0.2 % of its height."""

LEAST, MOST = 8, 1 << 16
"""Smallest number of samples that give a spectrum, and the largest number that is transformed."""

PERIODS = 2.0
"""Fewest periods within the window that make a peak a vibration; the window's own main lobe reaches as far."""

SHOWN = 1e-3
"""Amplitudes relative to the largest, below which nothing is drawn."""


def spectrum(time: RealArray, values: RealArray, begin: float) -> tuple[RealArray, RealArray] | None:
    """Return frequencies (K,) [Hz] and amplitudes (K,) of a signal from a time on, its mean removed.

    Args:
        time: (N,) instants [s], not decreasing.
        values: (N,) values; between the instants they are interpolated linearly.
        begin: start of the signal [s].

    Returns:
        The spectrum; None where there are fewer than `LEAST` instants, or a value isn't finite.
    """
    chosen = time >= begin
    time, values = time[chosen], values[chosen]
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    if steps.size < LEAST or not np.all(np.isfinite(values)):
        return None
    # equal steps, which are those of the recording where that has them
    count = min(round((time[-1] - time[0]) / float(np.sort(steps)[steps.size // 2])), MOST)
    grid = np.linspace(time[0], time[-1], count + 1)
    sampled = np.interp(grid, time, values)
    # the window weighs the mean too, so that none of it leaks
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(count + 1) / count)
    sampled = (sampled - window @ sampled / window.sum()) * window
    length = 1 << (PADDING * (count + 1) - 1).bit_length()
    amplitude = 2.0 * np.abs(np.fft.rfft(sampled, length)) / window.sum()
    return np.fft.rfftfreq(length, grid[1] - grid[0]), amplitude


def peak(frequency: RealArray, amplitude: RealArray) -> tuple[float, float]:
    """Return frequency [Hz] and height of the highest peak, from a parabola through the logarithms of three neighbours."""
    i = int(np.argmax(amplitude))
    if not 0 < i < amplitude.size - 1 or not np.all(amplitude[i - 1 : i + 2] > 0.0):
        return float(frequency[i]), float(amplitude[i])
    left, top, right = np.log(amplitude[i - 1 : i + 2])
    shift = 0.5 * (left - right) / (left - 2.0 * top + right)
    height = np.exp(top - 0.25 * (left - right) * shift)
    return float(frequency[i] + shift * (frequency[1] - frequency[0])), float(height)


def spectrum_caption(what: str = "Amplitudes after the end of the motion") -> str:
    """Return a sentence about spectra that states the window."""
    return f"{what}, mean removed: Hann window, zeros appended to {PADDING} times the length."


def spectrum_panel(
    label: str, curves: Sequence[Curve], marks: Sequence[tuple[float, str]] = (), window: float = np.inf
) -> Panel:
    """Return spectra with a logarithmic vertical axis, the highest peak of all with its frequency if that is resolved.

    Args:
        label: of the vertical axis.
        curves: spectra by `spectrum`.
        marks: known natural frequencies [Hz] and their names.
        window: length of the signals [s]; what has less than `PERIODS` in it may be drift as well.
    """
    curves = [curve for curve in curves if np.max(curve.y, initial=0.0) > 0.0]
    if not curves:
        return Panel(label=label, curves=())
    frequency, height = max((peak(curve.x, curve.y) for curve in curves), key=lambda each: each[1])
    floor = SHOWN * height
    # up to where something is seen
    last = max(float(np.max(curve.x[curve.y > floor], initial=0.0)) for curve in curves)
    limits = 0.0, max(1.1 * last, 2.0 * frequency)
    curves = [replace(curve, x=curve.x[curve.x <= limits[1]], y=curve.y[curve.x <= limits[1]]) for curve in curves]
    text = Marker(frequency, height, text=f"{frequency:.4g} Hz", offset=(5.0, -4.0))
    markers = [text] if frequency >= PERIODS / window else []
    shown = [mark for mark in marks if limits[0] < mark[0] < limits[1]]
    return Panel(label=label, curves=curves, markers=markers, limits=limits, least=floor, logarithmic="y", marks=shown)

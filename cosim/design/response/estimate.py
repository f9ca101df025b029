"""Frequency responses from logs: of periodic excitation, averaged over its periods, or of any by Welch's method.

Both are one estimate with instruments. Of records r, periods or overlapping segments under a Hann window, with the transforms X of the
inputs and Y of the outputs, and instruments Z, the response at a frequency is G = Σ Y Z* (Σ X Z*)^-1. Z is X for Welch's H1, the mean of X
over the periods for periodic excitation, in which noise of the inputs averages out too, or a named reference, which makes both unbiased in
closed loops: noise isn't correlated with it, as it is with an input that a controller feeds back. The scatter of the residuals Y - G X
gives the standard errors, and the coherence.

Sources: R. Pintelon and J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed., Wiley 2012, sections 2.4 to 2.7; P. Welch,
The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio Electroacoustics 15 (1967); P. Wellstead, Non-parametric
methods of system identification, Automatica 17 (1981), for the instruments.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter
from scipy.signal import detrend, get_window

from flexfmu.cosim.control.controllers.joints import unit_of
from flexfmu.cosim.design.response.response import ComplexArray, FrequencyResponse
from flexfmu.cosim.engine.errors import DataWarning, InputError
from flexfmu.cosim.engine.measured import Log, Mapped, read_log
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.trajectories.jets import RealArray

UNEVEN = 1e-3
"""Difference of steps, relative to the median step, from which a log is resampled."""

OVERLAP, SEGMENTS = 0.5, 8
"""Overlap of Welch's segments, and the number of them where their length isn't given."""

INDEPENDENT = 0.95
"""Independent records that a segment of the Hann window is worth, half of which overlaps with the next one (Welch 1967)."""

LEAST = 16
"""Smallest number of samples in a period or segment."""

EXCITED, SIGNIFICANT, NEIGHBOURS = 1e-4, 25.0, 41
"""Magnitude at a line, relative to the largest one, from which it counts as excited, ratio of its power to that of the mean's noise, and number
of lines of which the median tells how large that is."""


def estimate_response(
    logs: Sequence[Log | Run],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    period: float | None = None,
    skip: int = 1,
    segment: float | None = None,
    reference: Sequence[str] = (),
    between: tuple[float, float] | None = None,
    band: tuple[float, float] | None = None,
    held: bool = True,
    mapping: Mapping[str, Mapped] = MappingProxyType({}),
) -> FrequencyResponse:
    """Estimate a response; see `flexfmu.frequency_response`."""
    found, step, even, units = list[tuple[RealArray, RealArray, RealArray]](), 0.0, True, dict[str, str]()
    n, m = len(inputs), len(outputs)
    for log in logs:
        signals, own, resampled, units = _signals(
            log, (*inputs, *outputs, *(reference or inputs)), between, period, mapping
        )
        if step and abs(own - step) > UNEVEN * step:
            raise InputError(f"the logs have different sample times, {1e3 * step:g} and {1e3 * own:g} ms: resample one")
        step, even = own, even and not resampled
        found.append((signals[:n], signals[n : n + m], signals[n + m :]))
    x, y, z, frequency = _records(found, step, period, skip, segment)
    inside = np.ones(len(frequency), bool) if band is None else (frequency >= band[0]) & (frequency <= band[1])
    moving = all(np.ptp(row) for signals in found for row in signals[0])
    inside[inside] = moving and _excited(x[:, inside], z[:, inside], n, period is not None and not reference)
    if np.count_nonzero(inside) < 2:
        where = "" if band is None else f" between {band[0]:g} and {band[1]:g} Hz"
        raise InputError(
            f"{', '.join(reference or inputs)} excites nothing{where}, of {len(frequency)} frequencies from {frequency[0]:g} to "
            f"{frequency[-1]:g} Hz: no response can be estimated; excite it there, or give another `band`"
        )
    worth = 1.0 if period is not None else INDEPENDENT
    response, error, coherence = _solved(x[:, inside], y[:, inside], z[:, inside], worth)
    # a sum is called like its first term
    named = [tuple(each.split("+")[0].strip() for each in names) for names in (inputs, outputs)]
    sample_time = step if held and even else None
    return FrequencyResponse(frequency[inside], response, named[0], named[1], units, error, coherence, sample_time)


def _signals(
    log: Log | Run,
    names: Sequence[str],
    between: tuple[float, float] | None,
    period: float | None,
    mapping: Mapping[str, Mapped],
) -> tuple[RealArray, float, bool, dict[str, str]]:
    """Signals (len(names), N) at equal steps, the step [s], whether they were resampled, and units; a name may be a sum, ``a+b``."""
    what = Path(log) if isinstance(log, str) else log if isinstance(log, Path) else "the log"
    terms = {term.strip() for name in names for term in name.split("+")}
    source: Any = log.recording if isinstance(log, Run) else log
    given = source.units if isinstance(source, Recording) else {}
    recording = read_log(source, mapping, {term: given.get(term) or unit_of(term) for term in sorted(terms)})
    if missing := terms - {*recording.columns}:
        raise InputError(f"{what} has no signal {min(missing)!r}")
    # of instants that appear twice, the values after the jump
    time = recording.time
    kept = np.append(np.diff(time) > 0.0, True)
    if between is not None:
        kept &= (time >= between[0]) & (time <= between[1])
    time = time[kept]
    columns = {term: recording[term].values[kept] for term in terms}
    for term, values in columns.items():
        if not np.isfinite(values).all():
            at = time[np.flatnonzero(~np.isfinite(values))[0]]
            raise InputError(
                f"{what}: {term} has no number at {at:g} s: choose a part of the log without gaps, `between`"
            )
    if len(time) < LEAST:
        raise InputError(f"{what} has {len(time)} samples: a response needs at least {LEAST}")
    units = {first: recording[first].unit for first in (name.split("+")[0].strip() for name in names)}
    values = np.array([sum(columns[term.strip()] for term in name.split("+")) for name in names])
    step = float(np.median(np.diff(time)))
    parts = 1 if period is None else max(round(period / step), 1)
    wanted = step if period is None or abs(parts * step - period) <= UNEVEN * step else period / parts
    uneven = float(np.abs(np.diff(time) - step).max()) > UNEVEN * step
    if uneven or wanted != step:
        why = "its steps aren't equal" if uneven else f"the period isn't a multiple of its step of {1e3 * step:g} ms"
        warnings.warn(
            f"{what} is resampled at {1e3 * wanted:.6g} ms, since {why}: the response is that of continuous signals",
            DataWarning,
            stacklevel=4,
        )
        grid = time[0] + wanted * np.arange(int((time[-1] - time[0]) / wanted + 1e-6) + 1)
        return CubicSpline(time, values, axis=1)(grid), wanted, True, units
    return values, float((time[-1] - time[0]) / (len(time) - 1)), False, units


def _records(
    found: Sequence[tuple[RealArray, RealArray, RealArray]],
    step: float,
    period: float | None,
    skip: int,
    segment: float | None,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, RealArray]:
    """Transforms (records, frequencies, signals) of inputs, outputs and instruments, and frequencies [Hz]."""
    shortest = min(each[0].shape[1] for each in found) * step
    size = round((period or segment or 2.0 * shortest / (SEGMENTS + 1)) / step)
    count = shortest / step / size - skip if period else 2.0 * shortest / step / size - 1.0
    if size < LEAST or count < 2.0:
        what = f"periods of {period:g} s, of which {skip} are left out" if period else f"segments of {size * step:g} s"
        raise InputError(
            f"a log of {shortest:.4g} s with {size} samples in each has too few {what}: at least 2 more are needed, with {LEAST} samples each"
        )
    records: list[list[ComplexArray]] = [[], [], []]
    for signals in found:
        if period:
            whole = signals[0].shape[1] // size - skip
            parts = [_periods(each[:, each.shape[1] - whole * size :], whole) for each in signals]
            # the instruments are means over the periods
            parts[2] = np.broadcast_to(parts[2].mean(0), parts[2].shape)
        else:
            parts = [_windowed(each, size) for each in signals]
        for each, part in zip(records, parts, strict=True):
            each.append(part)
    # without the mean and, where the window widens it, its neighbour
    first = 1 if period else 2
    x, y, z = (np.concatenate(each)[:, first:] for each in records)
    return x, y, z, np.asarray(np.fft.rfftfreq(size, step), float)[first:]


def _periods(signals: RealArray, count: int) -> ComplexArray:
    """Transforms (periods, frequencies, signals), without the drift from period to period."""
    parts = signals.reshape(len(signals), count, -1)
    slope = np.polyfit(np.arange(count), parts.mean(2).T, 1)[0] / parts.shape[2]
    drift = slope[:, np.newaxis] * np.arange(signals.shape[1])
    return np.asarray(np.fft.rfft(parts - drift.reshape(parts.shape), axis=2).transpose(1, 2, 0))


def _windowed(signals: RealArray, size: int) -> ComplexArray:
    """Transforms (segments, frequencies, signals) under a Hann window, each segment without its trend."""
    parts = sliding_window_view(signals, size, axis=1)[:, :: max(round(size * (1.0 - OVERLAP)), 1)]
    return np.asarray(np.fft.rfft(detrend(parts, axis=2) * get_window("hann", size), axis=2).transpose(1, 2, 0))


def _excited(x: ComplexArray, z: ComplexArray, count: int, are_means: bool) -> Any:
    """Frequencies at which the instruments move the inputs, in as many directions as there are inputs; means of these beyond their noise."""
    least = np.linalg.svd(np.einsum("rfi,rfj->fij", x, z.conj()), compute_uv=False)
    least = least[:, count - 1] if least.shape[1] >= count else np.zeros(len(least))
    found = (least > EXCITED**2 * least.max(initial=0.0)) & (least > 0.0)
    if are_means:
        # of the neighbours, as few periods scatter much
        noise = median_filter(np.var(z - x, axis=0).sum(1), NEIGHBOURS, mode="nearest")
        found &= np.mean(np.abs(z) ** 2, axis=0).sum(1) > SIGNIFICANT * noise / len(x)
    return found


def _solved(
    x: ComplexArray, y: ComplexArray, z: ComplexArray, worth: float
) -> tuple[ComplexArray, RealArray, RealArray]:
    """Response (N, outputs, inputs), standard errors of its parts, and coherence (N, outputs)."""
    taken = np.einsum("rfi,rfj->fij", x, z.conj())
    inverse = np.linalg.pinv(taken)
    response = np.einsum("rfo,rfj->foj", y, z.conj()) @ inverse
    rest = y - np.einsum("foi,rfi->rfo", response, x)
    free = max(worth * len(x) - x.shape[2], 1.0)
    noise = np.sum(np.abs(rest) ** 2, axis=0) * worth / free
    # a covariance of the inputs' errors: those of the records add up, each worth its share
    squares = np.einsum("rfi,rfj->fij", z, z.conj())
    spread = np.einsum("fji,fjk,fki->fi", inverse.conj(), squares, inverse).real
    error = np.sqrt(0.5 * noise[:, :, np.newaxis] * np.maximum(spread, 0.0)[:, np.newaxis] / worth)
    power = np.sum(np.abs(y) ** 2, axis=0)
    coherence = 1.0 - np.sum(np.abs(rest) ** 2, axis=0) / np.where(power > 0.0, power, 1.0)
    return response, error, np.clip(coherence, 0.0, 1.0)

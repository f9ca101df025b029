"""The time grid of a run: integer ticks start + n * step, with every mark landed on exactly."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.errors import InputError

Instants = NDArray[np.float64]

COINCIDENT = 1e-6
"""Instants nearer than this fraction of the communication step are one instant, that of the mark.

A mark (a knot of the trajectory, say) and a tick differ by rounding, about 1e-12 of a step after 1e5 of them; a step
of less than a millionth of the others would only cost time and digits."""

MAXIMUM_POINTS = 20_000_000
"""More communication points than this are taken for a mistake in the step's unit."""


@dataclass(frozen=True)
class TimeGrid:
    """Communication points of a run.

    Attributes:
        times: (N + 1,) communication points [s], strictly increasing, start and stop included.
        marked: (N + 1,) whether the point is a mark: signals may jump there.
    """

    times: Instants
    marked: NDArray[np.bool_]


def time_grid(start: float, stop: float, step: float, marks: Iterable[float] = ()) -> TimeGrid:
    """Ticks start + n * step and marks from start to stop; the last step may be shorter.

    Raises:
        InputError: the step isn't positive, the stop isn't after the start, or there would be far too many points.
    """
    if not (0.0 < step < np.inf and -np.inf < start < stop < np.inf):
        raise InputError(f"need a step > 0 and start < stop, got start {start} s, stop {stop} s, step {step} s")
    if (stop - start) / step > MAXIMUM_POINTS:
        raise InputError(f"a communication step of {step} s makes {(stop - start) / step:.3g} steps; take a larger one")
    near = COINCIDENT * step
    inside = [mark for mark in marks if start - near < mark < stop + near]
    fixed = merge([start, stop, *inside], near)
    fixed[0], fixed[-1] = start, stop
    ticks = start + step * np.arange(int((stop - start) / step + 1.0), dtype=np.float64)
    ticks = ticks[_distance(ticks, fixed) > near]
    times = np.union1d(ticks[ticks < stop], fixed)
    marked = _distance(times, np.asarray(inside)) <= near if inside else np.zeros(times.shape, dtype=np.bool_)
    return TimeGrid(times, marked)


def merge(instants: Iterable[float], near: float) -> Instants:
    """Ascending instants, of each group of neighbours nearer than ``near`` the first."""
    ascending = np.unique(np.fromiter(instants, dtype=np.float64))
    return ascending[np.diff(ascending, prepend=-np.inf) > near]


def _distance(times: Instants, marks: Instants) -> Instants:
    """Distance of each time to the nearest mark; ``marks`` need not be sorted."""
    ascending = np.sort(marks)
    after = np.searchsorted(ascending, times).clip(0, ascending.size - 1)
    before = (after - 1).clip(0)
    distance: Instants = np.minimum(abs(ascending[after] - times), abs(ascending[before] - times))
    return distance


def sample_instants(sample_time: float, start: float, stop: float) -> Instants:
    """Instants start + k * sample_time up to ``stop`` [s].

    Raises:
        InputError: the sample time isn't positive, or there would be far too many instants.
    """
    if not 0.0 < sample_time < np.inf or (stop - start) / sample_time > MAXIMUM_POINTS:
        raise InputError(f"a sample time of {sample_time} s doesn't suit a run from {start} s to {stop} s")
    return start + sample_time * np.arange(int((stop - start) / sample_time + 1.0 + COINCIDENT), dtype=np.float64)


def is_sample_instant(grid: TimeGrid, sample_time: float) -> NDArray[np.bool_]:
    """(N + 1,) which communication points are sample instants."""
    instants = sample_instants(sample_time, float(grid.times[0]), float(grid.times[-1]))
    points: NDArray[np.bool_] = np.zeros(grid.times.shape, dtype=np.bool_)
    after = np.searchsorted(grid.times, instants).clip(1, grid.times.size - 1)
    nearer_before = instants - grid.times[after - 1] < grid.times[after] - instants
    points[after - nearer_before] = True
    return points

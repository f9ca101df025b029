"""The exception of this package, and checks of arguments: each returns the checked value or raises a `TrajectoryError` with value,
unit and limits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.errors import Error


class TrajectoryError(Error, ValueError):
    """A trajectory can't be planned or evaluated with these arguments.

    The message is one line: the value with its unit and place, the limits, and what to change.
    """


def positive(name: str, value: float, unit: str) -> float:
    """Return a number; raise TrajectoryError unless it is finite and above zero."""
    if not (math.isfinite(value) and value > 0.0):
        raise TrajectoryError(f"{name} must be above zero and finite, got {value:g} {unit}")
    return float(value)


def plane_vector(name: str, value: ArrayLike, unit: str) -> tuple[float, float]:
    """Return two components; raise TrajectoryError unless both are finite numbers."""
    vector = np.asarray(value, dtype=float)
    if vector.shape != (2,) or not np.all(np.isfinite(vector)):
        raise TrajectoryError(f"{name} must be two finite numbers [{unit}], got {value!r}")
    return float(vector[0]), float(vector[1])


def times(value: ArrayLike) -> NDArray[np.float64]:
    """Return times [s] as an array of shape (N,); raise TrajectoryError unless all are finite."""
    time = np.atleast_1d(np.asarray(value, dtype=float))
    if time.ndim != 1:
        raise TrajectoryError(f"times must be one number or an array of shape (N,), got shape {time.shape}")
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise TrajectoryError(f"times must be finite, got {time[bad[0]]} s at index {bad[0]}")
    return time


def within(name: str, value: ArrayLike, limit: float, unit: str) -> NDArray[np.float64]:
    """Return numbers as an array of at least one axis; raise TrajectoryError unless all are between 0 and ``limit``."""
    values = np.atleast_1d(np.asarray(value, dtype=float))
    bad = np.flatnonzero(~((values >= 0.0) & (values <= limit)))
    if bad.size:
        raise TrajectoryError(
            f"{name} must be between 0 and {limit:.9g} {unit}, got {values[bad[0]]} at index {bad[0]}"
        )
    return values

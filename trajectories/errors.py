"""The one exception of this package, and the checks of what a user gives: each returns the value or raises it, with value,
unit and remedy."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


class TrajectoryError(ValueError):
    """A trajectory that cannot be planned or evaluated as asked.

    The message is one line with the value, where it was found, its unit, the limits, and what to change.
    """


def positive(name: str, value: float, unit: str) -> float:
    """A finite number above zero."""
    if not (math.isfinite(value) and value > 0.0):
        raise TrajectoryError(f"{name} must be above zero and finite, got {value:g} {unit}")
    return float(value)


def plane_vector(name: str, value: ArrayLike, unit: str) -> tuple[float, float]:
    """Two finite components."""
    vector = np.asarray(value, dtype=float)
    if vector.shape != (2,) or not np.all(np.isfinite(vector)):
        raise TrajectoryError(f"{name} must be two finite numbers [{unit}], got {value!r}")
    return float(vector[0]), float(vector[1])


def times(value: ArrayLike) -> NDArray[np.float64]:
    """Finite times [s] as an array of shape (N,)."""
    time = np.atleast_1d(np.asarray(value, dtype=float))
    if time.ndim != 1:
        raise TrajectoryError(f"times must be one number or an array of shape (N,), got shape {time.shape}")
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise TrajectoryError(f"times must be finite, got {time[bad[0]]} s at index {bad[0]}")
    return time


def within(name: str, value: ArrayLike, limit: float, unit: str) -> NDArray[np.float64]:
    """Numbers between 0 and ``limit`` as an array of shape (N,)."""
    values = np.atleast_1d(np.asarray(value, dtype=float))
    bad = np.flatnonzero(~((values >= 0.0) & (values <= limit)))
    if bad.size:
        raise TrajectoryError(
            f"{name} must be between 0 and {limit:.9g} {unit}, got {values[bad[0]]} at index {bad[0]}"
        )
    return values

"""Values of curves inside a page, for zooming and reading: base64 of little-endian 32-bit numbers, 24 significant bits each."""

from __future__ import annotations

import base64

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.slave import RealArray

MOST_POINTS = 2000
"""Largest number of points of a curve that a page has."""


def thinned(y: RealArray, most: int = MOST_POINTS) -> NDArray[np.intp]:
    """Return the indices of at most ``most`` of the values (N,), four at least: all, or the smallest and largest of equal pieces.

    First and last value are among them, and so are the smallest and largest of all.
    """
    if y.size <= most:
        return np.arange(y.size)
    # NaN breaks a curve; it is neither smallest nor largest
    size = -(-y.size // (most // 2 - 1))
    padded = np.append(y, np.full(-y.size % size, np.nan)).reshape(-1, size)
    starts = size * np.arange(len(padded))
    least = np.where(np.isfinite(padded), padded, np.inf).argmin(axis=1)
    most = np.where(np.isfinite(padded), padded, -np.inf).argmax(axis=1)
    found = np.concatenate([[0], starts + least, starts + most, [y.size - 1]])
    found = np.sort(found[found < y.size])
    return np.asarray(found[np.diff(found, prepend=-1) > 0])  # `np.unique` would load numpy.ma


def spread(count: int) -> NDArray[np.intp]:
    """Return at most `MOST_POINTS` equally spaced indices of ``count`` values, first and last included."""
    return np.arange(count) if count <= MOST_POINTS else np.linspace(0, count - 1, MOST_POINTS).astype(np.intp)


def packed(*channels: RealArray) -> str:
    """Return arrays one after the other as base64 of 32-bit numbers."""
    return base64.b64encode(np.concatenate([np.ravel(each) for each in channels]).astype("<f4").tobytes()).decode()


def unpacked(text: str, channels: int) -> RealArray:
    """Return the arrays (channels, N) of `packed`."""
    return np.frombuffer(base64.b64decode(text), dtype="<f4").astype(np.float64).reshape(channels, -1)

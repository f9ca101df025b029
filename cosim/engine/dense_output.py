"""Signals between communication points: Hermite interpolation through four of them with two derivatives each.

The polynomial of degree 3 k - 1 takes on value, first and second derivative at k neighbouring communication points. In
terms of Lagrange's polynomials l_i of these points, the basis for the derivative of order r at point i is
l_i^3 (t - t_i)^r / r! times the Taylor polynomial of degree 2 - r of l_i^-3 about t_i (A. Spitzbart, A generalization of
Hermite's interpolation formula, Amer. Math. Monthly 67, 1960).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from math import comb, factorial

import numpy as np
from numpy.lib.stride_tricks import as_strided

from flexfmu.cosim.engine.fmu.calls import address
from flexfmu.cosim.engine.results import Column, LazyColumns, Recording, SignalTable
from flexfmu.cosim.engine.shared_library import c_structures, shared_library
from flexfmu.cosim.engine.slave import COINCIDENT, Indices, RealArray

KNOWN = 3
"""Value, first and second derivative at each communication point."""

POINTS = 4
"""Number of communication points of an interpolant: two on either side, fewer where signals may jump."""


Signal = tuple[int, int, int, int, int]
"""Where a signal is in a table, and what is interpolated; see `DenseOutput.of`."""


def hermite_weights(nodes: RealArray, time: RealArray, order: int) -> RealArray:
    """Return the weights of value and derivatives at the nodes in the interpolating polynomial at given times.

    Args:
        nodes: (R, k) times of the nodes [s], distinct in each row.
        time: (R,) times of evaluation [s], none of them at a node of its row.
        order: highest derivative of the polynomial to return.

    Returns:
        (order + 1, R, k, 3) weights of value, first and second derivative at each node.
    """
    own = np.eye(nodes.shape[1], dtype=np.bool_)
    x = (time[:, None] - nodes)[..., None]
    # l_i, and sums of 1 / (t_i - t_j) and of their squares, which give the Taylor polynomial of l_i^-3
    apart = np.where(own, np.inf, nodes[:, :, None] - nodes[:, None, :])
    slope, curvature = (1.0 / apart).sum(axis=2)[..., None], (1.0 / apart**2).sum(axis=2)[..., None]
    lagrange = np.where(own, 1.0, x[:, None, :, 0] / np.where(own, 1.0, apart)).prod(axis=2)[..., None]
    # the basis is l_i^3 p_r with polynomials p_r of degree 2, here with their derivatives
    a, b, one = -3.0 * slope, 4.5 * slope**2 + 1.5 * curvature, np.ones_like(x)
    p = [
        np.concatenate([1.0 + a * x + b * x**2, x + a * x**2, 0.5 * x**2], axis=2),
        np.concatenate([a + 2.0 * b * x, 1.0 + 2.0 * a * x, x], axis=2),
        np.concatenate([2.0 * b, 2.0 * a, one], axis=2),
    ]
    # derivatives of l_i^3 by its logarithmic derivative s
    inverse = np.where(own, 0.0, 1.0 / x[:, None, :, 0])
    s = [3.0 * (-1.0) ** m * factorial(m) * (inverse ** (m + 1)).sum(axis=2)[..., None] for m in range(order)]
    cube = [lagrange**3]
    for n in range(order):
        cube.append(sum(comb(n, j) * cube[j] * s[n - j] for j in range(n + 1)))
    return np.stack([
        sum(comb(n, j) * cube[n - j] * p[j] for j in range(min(n, 2) + 1)) + 0.0 * p[0] for n in range(order + 1)
    ])  # fmt: skip


class DenseOutput:
    """Interpolates recordings with the same communication points at other instants.

    Args:
        points: (N,) recorded communication points [s]; where signals may jump they appear twice.
        instants: (R,) instants [s], ascending. Start, end and jumps are instants as well, jumps twice.
        order: highest derivative that is interpolated.

    Attributes:
        time: (M,) all instants [s].
    """

    def __init__(self, points: RealArray, instants: RealArray, order: int) -> None:
        # ends of the pieces between jumps are instants, and points that coincide with an instant
        edge = np.flatnonzero(np.diff(points) == 0.0)
        begins, ends = np.concatenate([[0], edge + 1]), np.concatenate([edge, [points.size - 1]])
        near = COINCIDENT * float(np.diff(points).max(initial=0.0))
        inner = instants[(instants > points[0] + near) & (instants < points[-1] - near)]
        nearest = points.searchsorted(inner)
        nearest -= inner - points[nearest - 1] < points[nearest] - inner
        lands = abs(points[nearest] - inner) <= near
        fixed = np.union1d(np.concatenate([begins, ends]), nearest[lands])
        between = inner[~lands]
        # all instants in order: fixed ones after those between that are earlier
        places = np.searchsorted(between, points[fixed]) + np.arange(fixed.size)
        self.time = np.empty(fixed.size + between.size)
        rest = np.delete(np.arange(self.time.size), places)
        self.time[places], self.time[rest] = points[fixed], between
        # points that are instants, and the last point before each of the others
        segment = points.searchsorted(between) - 1
        self._points, self._last = np.full(self.time.size, -1, np.int64), np.empty(self.time.size, np.intp)
        self._points[places] = self._last[places] = fixed
        self._last[rest] = segment
        # four points around each instant between, with weights; fewer of them in short pieces
        self._begins = np.zeros(self.time.size, np.int64)
        self._weights = np.zeros((order + 1, self.time.size, KNOWN, POINTS))
        piece = ends.searchsorted(segment, "right")
        counts = np.minimum(POINTS, ends[piece] - begins[piece] + 1)
        for count in np.unique(counts).tolist():
            of = np.flatnonzero(counts == count)
            first = np.clip(segment[of] - count // 2 + 1, begins[piece][of], ends[piece][of] + 1 - count)
            own = first[:, None] + np.arange(count)
            weights = hermite_weights(points[own], between[of], order).swapaxes(2, 3)
            begin = self._begins[rest[of]] = np.clip(first, 0, max(points.size - POINTS, 0))
            columns = own - begin[:, None]
            self._weights[:, rest[of][:, None, None], np.arange(KNOWN)[:, None], columns[:, None]] = weights
        self._signals: tuple[Mapping[str, tuple[str, range]], Mapping[str, Signal]] | None = None
        self._in_c = c_structures("master")["master_dense"](
            self.time.size, *map(address, (self._begins, self._points, self._weights))
        )

    def of(self, rows: RealArray, signals: Indices, orders: int) -> RealArray:
        """Return derivatives of signals at all instants, (S, orders, M).

        Args:
            rows: (n, N) values and derivatives at the communication points.
            signals: (S, 5) for each signal the row of its values, and how many rows further first and second derivatives are
                each; row and distance of rows of what was recorded, for the instants that are communication points; lowest
                derivative to return, 0 for the value.
            orders: number of derivatives to return, up to 3.
        """
        found = np.empty((len(signals), orders, self.time.size))
        if rows.shape[1] < POINTS:
            rows = np.pad(rows, ((0, 0), (0, POINTS - rows.shape[1])))
        signals, distance = np.ascontiguousarray(signals, np.int64), rows.strides[0] // rows.itemsize
        start = int(rows.ctypes.data)  # contiguous rows, at this distance
        shared_library("master").master_interpolate(
            self._in_c, start, distance, address(signals), len(signals), orders, address(found)
        )
        return found

    def signals_in(self, table: SignalTable) -> Mapping[str, Signal]:
        """Numbers for `of` of a table's signals; runs of one system have the same ones."""
        if self._signals is None or self._signals[0] is not table.places:
            self._signals = table.places, smooth_signals(table.places)
        return self._signals[1]

    def held(self, column: Column) -> Column:
        """A column without two derivatives, held between the communication points."""
        return Column(column.unit, column.values[self._last], texts=column.texts)


def windows(known: RealArray, count: int) -> RealArray:
    """Return value and derivatives (N, 3, S) at each ``count`` successive points, (N - count + 1, 3 count, S), as a view."""
    known = np.ascontiguousarray(known)
    points, _, signals = known.shape
    return as_strided(known, (points - count + 1, KNOWN * count, signals), known.strides, writeable=False)


def resampled(recording: Recording, dense: DenseOutput, order: int) -> Recording:
    """Return a recording, made with two derivatives, at other instants.

    A signal named ``der(x)`` or ``der(x,2)`` is the derivative of the interpolant of ``x``, where that was recorded too: its own
    derivatives are those of vibrations far faster than the steps.

    Args:
        recording: signals at the communication points; one without derivatives is held.
        dense: their interpolation.
        order: highest derivative to keep, 0 to 2.
    """
    columns, table = recording.columns, SignalTable.of(recording.columns)
    signals = dense.signals_in(table)

    @cache
    def found() -> dict[str, RealArray]:
        """All at once, when the first is asked for."""
        return dict(zip(signals, dense.of(table.rows, np.array([*signals.values()]), order + 1), strict=True))

    def column(name: str) -> Column:
        return Column(table.places[name][0], *found()[name]) if name in signals else dense.held(columns[name])

    return Recording(dense.time, LazyColumns(columns, column))


def smooth_signals(places: Mapping[str, tuple[str, range]]) -> dict[str, Signal]:
    """Name → numbers for `DenseOutput.of` of the signals with two derivatives."""
    smooth = {name: own for name, (_, own) in places.items() if len(own) >= KNOWN}
    found: dict[str, Signal] = {}
    for name, own in smooth.items():
        base, lowest = integral(name) or (name, 0)
        if base not in smooth:
            base, lowest = name, 0
        found[name] = smooth[base].start, smooth[base].step, own.start, own.step, lowest
    return found


def known_signals(recording: Recording) -> RealArray:
    """Return value and two derivatives at the communication points, (N, 3, S), of the signals that aren't derivatives of others."""
    smooth = (name for name, column in recording.columns.items() if column.second is not None)
    names = [name for name in smooth if integral(name) is None]
    columns = [recording[name] for name in names]
    known = np.empty((recording.time.size, KNOWN, len(names)))
    for order, kept in enumerate(("values", "first", "second")):
        known[:, order] = (
            np.array([getattr(column, kept) for column in columns]).reshape(len(names), recording.time.size).T
        )
    return known


@cache
def integral(name: str) -> tuple[str, int] | None:
    """The signal that ``der(x)`` or ``der(x,2)`` is a derivative of, and of which order; None for other names."""
    found = re.fullmatch(r"(?P<owner>(?:\w+\.)?)der\((?P<signal>.+?)(?:,(?P<order>2))?\)", name)
    return None if found is None else (found["owner"] + found["signal"], int(found["order"] or 1))

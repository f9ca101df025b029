"""Signals between communication points: Hermite interpolation through four of them with two derivatives each.

The polynomial of degree 3 k - 1 takes on value, first and second derivative at k neighbouring communication points. In
terms of Lagrange's polynomials l_i of these points, the basis for the derivative of order r at point i is
l_i^3 (t - t_i)^r / r! times the Taylor polynomial of degree 2 - r of l_i^-3 about t_i (A. Spitzbart, A generalization of
Hermite's interpolation formula, Amer. Math. Monthly 67, 1960).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from math import comb, factorial

import numpy as np
from numpy.lib.stride_tricks import as_strided

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import COINCIDENT, Indices, RealArray

KNOWN = 3
"""Value, first and second derivative at each communication point."""

POINTS = 4
"""Number of communication points of an interpolant: two on either side, fewer where signals may jump."""


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
        self._size = fixed.size + between.size
        self._fixed, self._at_fixed = fixed, places
        self._between = np.delete(np.arange(self._size), places)
        self.time = np.empty(self._size)
        self.time[places], self.time[self._between] = points[fixed], between
        # first point of each instant's interpolant, within its piece
        self._segment = segment = points.searchsorted(between) - 1
        piece = ends.searchsorted(segment, "right")
        self._groups = [
            _Group(points, between, np.flatnonzero(count == chosen), first, chosen, order)
            for count in [np.minimum(POINTS, ends[piece] - begins[piece] + 1)]
            for chosen in np.unique(count).tolist()
            for first in [np.clip(segment - chosen // 2 + 1, begins[piece], ends[piece] + 1 - chosen)]
        ]

    def of(self, known: RealArray, orders: int) -> RealArray:
        """Return signals and their derivatives at all instants, (orders, S, M).

        Args:
            known: (N, 3, S) value, first and second derivative of each signal at the communication points.
            orders: number of derivatives to return, the value included; those from the fourth on are undefined at the
                communication points themselves.
        """
        found = np.empty((orders, known.shape[2], self._size))
        found[:KNOWN, :, self._at_fixed] = known[self._fixed, :orders].transpose(1, 2, 0)
        for group in self._groups:
            found[:, :, self._between[group.instants]] = group.of(known, orders)
        return found

    def fix(self, column: Column, recorded: Column) -> None:
        """Replace what was interpolated by what was recorded, at the instants that are communication points."""
        for into, source in zip(_arrays(column), _arrays(recorded), strict=False):
            into[self._at_fixed] = source[self._fixed]

    def held(self, column: Column) -> Column:
        """A column without two derivatives, held between the communication points."""
        last = np.empty(self._size, np.intp)
        last[self._at_fixed], last[self._between] = self._fixed, self._segment
        return Column(column.unit, column.values[last], texts=column.texts)


def _arrays(column: Column) -> list[RealArray]:
    return [each for each in (column.values, column.first, column.second) if each is not None]


class _Group:
    """Instants between points whose interpolants have the same number of points.

    Instants with the same interpolant are one matrix product: (instants and orders, 3 k) times (3 k, signals).
    """

    def __init__(
        self, points: RealArray, time: RealArray, instants: Indices, first: Indices, count: int, order: int
    ) -> None:
        self.instants, self._count, self._first = instants, count, first[instants]
        # place of each instant among those with the same interpolant
        self._slot = np.arange(instants.size) - self._first.searchsorted(self._first)
        weights = hermite_weights(points[self._first[:, None] + np.arange(count)], time[instants], order)
        slots = int(self._slot.max(initial=-1)) + 1
        placed = np.zeros((points.size - count + 1, slots, order + 1, KNOWN * count))
        placed[self._first, self._slot] = weights.reshape(*weights.shape[:2], -1).swapaxes(0, 1)
        # those of the first derivatives, for each number of them
        shape = len(placed), -1, KNOWN * count
        self._weights = [placed[:, :, :orders].reshape(shape) for orders in range(1, order + 2)]

    def of(self, known: RealArray, orders: int) -> RealArray:
        """Return the signals (N, 3, S) and their derivatives at these instants, (orders, S, R)."""
        weights = self._weights[orders - 1]
        found = np.matmul(weights, windows(known, self._count))
        found = found.reshape(len(weights), -1, orders, known.shape[2])
        return np.asarray(found[self._first, self._slot].transpose(1, 2, 0))


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
    columns = recording.columns
    smooth = [name for name, column in columns.items() if column.second is not None]
    bases = {name: signal for name in smooth if (signal := integral(name)) is not None and signal[0] in columns}
    # signals with derivatives: first those of which others are derivatives
    several = list(dict.fromkeys(base for base, _ in bases.values()))
    found: dict[str, Column] = {}
    for names, orders in (
        (several, order + KNOWN),
        ([name for name in smooth if name not in {*several, *bases}], order + 1),
    ):
        if not names:
            continue
        values = dense.of(_known(recording, names), orders)
        found |= {name: Column(columns[name].unit, *values[: order + 1, i]) for i, name in enumerate(names)}
        if names is several:
            for name, (base, lowest) in bases.items():
                found[name] = Column(columns[name].unit, *values[lowest : lowest + order + 1, several.index(base)])
                # at the communication points it has its own values and derivatives
                dense.fix(found[name], columns[name])
    # the others, in the order of the recording
    return Recording(dense.time, {name: found.get(name) or dense.held(column) for name, column in columns.items()})


def known_signals(recording: Recording) -> RealArray:
    """Return value and two derivatives at the communication points, (N, 3, S), of the signals that aren't derivatives of others."""
    smooth = (name for name, column in recording.columns.items() if column.second is not None)
    return _known(recording, [name for name in smooth if integral(name) is None])


def _known(recording: Recording, names: Sequence[str]) -> RealArray:
    """Value and two derivatives of the signals at the communication points, (N, 3, S)."""
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

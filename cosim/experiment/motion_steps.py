"""Communication steps chosen from the motion: as long as the references and the values in between allow.

From every breakpoint on the steps grow, since a jump excites vibrations of all modes, and they are halved where the
polynomials of the references deviate. A first run then shows the error of the values in between, and the points are spread
so that it is the same in every step; where it still exceeds its part of the tolerance, steps are halved.
"""

from __future__ import annotations

import copy
from itertools import pairwise

import numpy as np

from flexfmu.cosim.engine.dense_output import KNOWN, POINTS, hermite_weights, known_signals, windows
from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.master.grid import merge
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.trajectories.trajectory import Trajectory, limits

LONGEST = 1.0 / 80.0
"""Longest step, as a fraction of the motion's duration, at a tolerance of `USUAL`."""

SHORTEST = 1e-2
"""First step after a breakpoint, as a fraction of the longest."""

GROWTH = 0.3
"""Growth of the steps after a breakpoint, by this fraction each, at a tolerance of `USUAL`."""

USUAL, ORDER = 1e-5, 3 * POINTS
"""The tolerance for these, and the order of the interpolation, whose error they are chosen for."""

REFERENCES = 0.1
"""Largest error of the reference accelerations, relative to the tolerance and to the largest."""

HALVINGS = 12
"""Most halvings of a step for the references."""

SAFETY = 4.0
"""Factor of the estimated error."""

INTEGRATION = 0.5
"""Part of the tolerance for the integration; the rest is for the values in between."""

TARGET = 0.4
"""Error for which the points are spread, as a fraction of what is allowed."""

STRETCH = 2.5
"""Largest ratio by which a step is changed where the points are spread."""

MOST_RUNS = 5
"""Largest number of runs by which the points are improved."""

WORTHWHILE = 0.5
"""A step is halved once more if the last halving has reduced its error to this fraction."""


def _first_points(motion: Trajectory, edges: RealArray, tolerance: float) -> RealArray:
    """Points between breakpoints for a motion and the tolerance of its run, (N,) [s]."""
    finer = (tolerance / USUAL) ** (1.0 / ORDER)
    longest, growth = LONGEST * motion.duration * finer, 1.0 + GROWTH * finer
    pieces = [begin + _graded(end - begin, longest, growth) for begin, end in pairwise(edges)]
    return _halved_for_references(motion, np.append(np.concatenate(pieces), edges[-1]), tolerance)


def _halved_for_references(motion: Trajectory, points: RealArray, tolerance: float) -> RealArray:
    """The points, and more of them where the references deviate from their polynomials."""
    for _ in range(HALVINGS):
        coarse = _reference_error(motion, points) > REFERENCES * tolerance
        if not coarse.any():
            break
        points = np.sort(np.append(points, _middles(points)[coarse]))
    return points


def _graded(width: float, longest: float, growth: float) -> RealArray:
    """Points of an interval from 0, the end left out: steps that grow from `SHORTEST` to the longest."""
    count = int(np.ceil(np.log(1.0 / SHORTEST) / np.log(growth)))
    steps = SHORTEST * longest * growth ** np.arange(count)
    if (rest := width - steps.sum()) > 0.0:
        steps = np.append(steps, np.full(int(np.ceil(rest / longest)), longest))
    ends = np.cumsum(steps)
    last = max(int(np.searchsorted(ends, width)), POINTS - 2)
    found: RealArray = np.append(0.0, ends[:last]) * (width / ends[last])
    return found


def _middles(points: RealArray) -> RealArray:
    return points[:-1] + 0.5 * np.diff(points)


def _reference_error(motion: Trajectory, points: RealArray) -> RealArray:
    """Deviation of the accelerations' polynomials, degree 9 through four derivatives, in the middle of each step (N,)."""
    begins = limits(motion, points[:-1], np.zeros(points.size - 1, dtype=np.bool_), 6)[2:]
    ends = limits(motion, points[1:], np.ones(points.size - 1, dtype=np.bool_), 6)[2:]
    width = np.diff(points)[:, None]
    polynomials = hermite_derivatives(begins, ends, width)
    terms = np.cumprod([np.ones_like(width), *(0.5 * width / k for k in range(1, len(polynomials)))], axis=0)
    exact = motion.evaluate(_middles(points), 2)[2]
    error = abs((polynomials * terms).sum(axis=0) - exact).max(axis=1)
    return np.asarray(error / max(abs(begins[0]).max(), np.finfo(float).tiny))


class ChosenSteps:
    """Communication points of runs of one motion, improved from run to run until the values in between are good enough.

    Args:
        motion: the references of both joints.
        stop: end of the run [s].
        tolerance: largest error, relative to the largest value of each signal; half of it is for the values in between.

    Attributes:
        points: the present communication points (N,) [s].
    """

    def __init__(self, motion: Trajectory, stop: float, tolerance: float) -> None:
        self._motion, self._allowed = motion, (1.0 - INTEGRATION) * tolerance
        self._edges = merge([*(each for each in motion.breakpoints if 0.0 <= each < stop), 0.0, stop], 0.0)
        self._enter(_first_points(motion, self._edges, tolerance))
        self._runs = 0

    def _enter(self, points: RealArray) -> None:
        self.points, self._before = points, np.full(points.size - 1, np.inf)
        self._estimate: ErrorEstimate | None = None

    def copy(self) -> ChosenSteps:
        """The same points, to be improved for other parameters of the robot."""
        other = copy.copy(self)
        other._enter(self.points)
        return other

    def improve(self, recording: Recording) -> bool:
        """Improve the points by a recording made with them; return whether they have changed."""
        if self._estimate is None:
            self._estimate = ErrorEstimate(recording.time)
        error = self._estimate.of(recording)
        self._runs += 1
        if self._runs == 1:
            points = self._spread(error)
            self._enter(_halved_for_references(self._motion, points, 2.0 * self._allowed))
            return True
        # halving once more doesn't help where the error has stayed
        coarse = (error > self._allowed) & (error < WORTHWHILE * self._before)
        if not coarse.any() or self._runs > MOST_RUNS:
            return False
        before = np.repeat(np.where(error > self._allowed, error, np.inf), 1 + coarse)
        self._enter(np.sort(np.append(self.points, _middles(self.points)[coarse])))
        self._before = before
        return True

    def _spread(self, error: RealArray) -> RealArray:
        """Points with the same error in every step, after its order; neighbouring steps are at most twice as long."""
        points, widths = self.points, np.diff(self.points)
        ratio = TARGET * self._allowed / np.maximum(error, np.finfo(float).tiny)
        wanted = (widths * np.clip(ratio ** (1.0 / ORDER), 1.0 / STRETCH, STRETCH)).tolist()
        cuts = points.searchsorted(self._edges).tolist()
        inner = sorted({*range(points.size - 1)} - {*cuts})
        for i in inner:
            wanted[i] = min(wanted[i], 2.0 * wanted[i - 1])
        for i in reversed(inner):
            wanted[i - 1] = min(wanted[i - 1], 2.0 * wanted[i])
        # in each piece between two edges a whole number of steps
        found = []
        for begin, end in pairwise(cuts):
            share = np.append(0.0, np.cumsum(widths[begin:end] / wanted[begin:end]))
            count = max(int(np.ceil(share[-1])), POINTS - 1)
            found.append(np.interp(np.linspace(0.0, share[-1], count + 1), share, points[begin : end + 1])[:-1])
        return np.append(np.concatenate(found), points[-1])


class ErrorEstimate:
    """Estimates the error of interpolants in the middle of each step, for recordings with the same points.

    The polynomials through two, three and four points differ by d, then by e; the next difference, which is the error,
    is e^2 / d where differences shrink, and no more than e.

    Args:
        points: recorded communication points (N,) [s]; where signals may jump they appear twice.
    """

    def __init__(self, points: RealArray) -> None:
        self._steps = np.flatnonzero(np.diff(points) > 0.0)
        jumps = np.flatnonzero(np.diff(points) == 0.0)
        begins, ends = np.concatenate([[0], jumps + 1]), np.concatenate([jumps, [points.size - 1]])
        piece = ends.searchsorted(self._steps, "right")
        # steps of pieces with fewer than four points aren't judged
        enough = ends[piece] - begins[piece] >= POINTS - 1
        self._judged, self._rough = np.flatnonzero(enough), np.flatnonzero(~enough)
        begins, ends, steps = begins[piece][enough], ends[piece][enough], self._steps[enough]
        self._first = np.clip(steps - 1, begins, ends - POINTS + 1)
        place = steps - self._first
        nodes, middle = points[self._first[:, None] + np.arange(POINTS)], points[steps] + 0.5 * np.diff(points)[steps]
        # weights of the interpolants through both ends of the step, one point more, and all
        polynomials = []
        for count in range(2, POINTS + 1):
            weights = np.zeros((steps.size, POINTS, KNOWN))
            chosen = np.minimum(place, POINTS - count)[:, None] + np.arange(count)
            rows = np.arange(steps.size)[:, None]
            weights[rows, chosen] = hermite_weights(nodes[rows, chosen], middle, 0)[0]
            polynomials.append(weights.reshape(steps.size, -1))
        self._weights = np.diff(np.stack(polynomials, axis=1), axis=1)

    def of(self, recording: Recording) -> RealArray:
        """Return the error of the worst signal for each step, relative to its largest value."""
        known = known_signals(recording)
        scale = np.maximum(abs(known[:, 0]).max(axis=0), np.finfo(float).tiny)
        before, last = abs(np.matmul(self._weights, windows(known, POINTS)[self._first])).swapaxes(0, 1)
        error = np.empty(self._steps.size)
        shrinking = np.minimum(1.0, SAFETY * last / np.maximum(before, np.finfo(float).tiny))
        error[self._judged], error[self._rough] = (last * shrinking / scale).max(axis=1), np.inf
        return error

"""The recorded instants of a scene's runs: communication points, or instants between them.

A robot that the references alone drive moves smoothly between breakpoints, so that values between communication points
follow from the derivatives there; with controllers or imperfections every recorded instant is a communication point.

Communication steps chosen from the motion: as long as the references and the values in between allow.

From every breakpoint on the steps grow, since a jump excites vibrations of all modes, and they are halved where the
polynomials of the references deviate. A first run then shows the error of the values in between, and the points are spread
so that it is the same in every step; where it still exceeds its part of the tolerance, steps are halved.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from flexfmu.cosim.engine.dense_output import (
    KNOWN,
    POINTS,
    DenseOutput,
    hermite_weights,
    known_signals,
    resampled,
    windows,
)
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.master.grid import merge
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.system import SceneSystem
from flexfmu.model.scene.cosimulation import RECORD_STEP
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
        # first points: steps that grow from each breakpoint
        finer = (tolerance / USUAL) ** (1.0 / ORDER)
        longest, growth = LONGEST * motion.duration * finer, 1.0 + GROWTH * finer
        pieces = [begin + _graded(end - begin, longest, growth) for begin, end in pairwise(self._edges)]
        self._enter(self._halved(np.append(np.concatenate(pieces), self._edges[-1]), tolerance))
        self._runs = 0

    def _halved(self, points: RealArray, tolerance: float) -> RealArray:
        """The points, and more of them where the references deviate from their polynomials."""
        for _ in range(HALVINGS):
            coarse = _reference_error(self._motion, points) > REFERENCES * tolerance
            if not coarse.any():
                break
            points = np.sort(np.append(points, _middles(points)[coarse]))
        return points

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
            self._enter(self._halved(self._spread(error), 2.0 * self._allowed))
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


DERIVATIVES = 2
"""Derivatives that values between communication points are calculated from."""

WHOLE = 1e-9
"""Rounding error of the ratio of two steps that users have typed in or calculated."""

Simulate = Callable[[RealArray | None, float], Simulation]
"""Function from communication points, None for the fixed step, and a tolerance to a simulation."""


class RecordedInstants:
    """Chooses communication points where there is no fixed step, and interpolates what is recorded between them.

    Args:
        parts: the slaves.
        motion: the planned motion.
        step: communication step [s]; None if it is chosen.
        wanted: which signals are recorded, how often, with how many derivatives.

    Attributes:
        recorded: what is recorded at the communication points.

    Raises:
        InputError: the step is open, but other slaves than the references drive the robot.
    """

    def __init__(self, parts: SceneSystem, motion: MotionPlan, step: float | None, wanted: Selection) -> None:
        self._motion, self._wanted = motion, wanted
        self._chooses = step is None
        smooth = (
            not parts.others
            and motion.scene.cosimulation.drive == "motion"
            and parts.plant.max_output_order >= DERIVATIVES
            and parts.references.ends_exactly
        )
        if self._chooses and not smooth:
            raise InputError(
                "communication steps are chosen where the planned motion alone drives the robot and its FMU takes and gives all "
                "derivatives; else name one: `cosimulation.step` (--step), 1e-3 s for example"
            )
        # between the points only where the interval isn't a whole number of steps
        ratio = 0.0 if step is None or wanted.step is None else wanted.step / step
        whole = ratio > 0.5 and abs(ratio - round(ratio)) <= WHOLE * ratio
        self._is_between = self._chooses or (smooth and wanted.step is not None and not whole)
        self.recorded = replace(wanted, order=DERIVATIVES, step=None) if self._is_between else wanted
        self._steps: ChosenSteps | None = None
        self._dense: tuple[RealArray, DenseOutput] | None = None

    @property
    def is_open(self) -> bool:
        """Whether communication points have to be chosen first."""
        return self._chooses and self._steps is None

    def follow(self, motion: MotionPlan) -> None:
        """Record runs of another motion from now on."""
        self._motion, self._steps = motion, None

    def forget(self) -> None:
        """Choose the communication points anew."""
        self._steps = None

    def choose(self, simulate: Simulate, stop: float, tolerance: float) -> None:
        """Choose the communication points by runs up to ``stop`` [s]."""
        steps = ChosenSteps(self._motion.joints, stop, tolerance)
        while (found := simulate(steps.points, INTEGRATION * tolerance)).outcome is Outcome.COMPLETED:
            if not steps.improve(found.recording):
                break
        self._steps = steps

    def run(self, simulate: Simulate, tolerance: float, *, own: bool) -> Simulation:
        """Simulate and interpolate.

        Args:
            simulate: simulates.
            tolerance: of the FMU.
            own: whether the run has the parameters for which the points were chosen.
        """
        if self._steps is None:
            found = simulate(None, tolerance)
        else:
            found = simulate(self._steps.points, INTEGRATION * tolerance)
            steps = None if own else self._steps.copy()
            while steps is not None and found.outcome is Outcome.COMPLETED and steps.improve(found.recording):
                found = simulate(steps.points, INTEGRATION * tolerance)
        return replace(found, recording=self._interpolated(found.recording)) if self._is_between else found

    def _interpolated(self, recording: Recording) -> Recording:
        """The recording at the wanted instants."""
        points = recording.time
        if points.size < 2:
            return recording
        if self._dense is None or not np.array_equal(self._dense[0], points):
            step = self._wanted.step or RECORD_STEP
            instants = points[0] + step * np.arange(int((points[-1] - points[0]) / step) + 1)
            self._dense = points, DenseOutput(points, instants, self._wanted.order + DERIVATIVES)
        return resampled(recording, self._dense[1], self._wanted.order)

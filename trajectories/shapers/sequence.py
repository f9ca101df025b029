"""Impulse sequences of input shapers, the vibration modes they are designed for, their residual vibration, and shaped motions.

An input shaper convolves a motion with a sequence Σ A_i δ(t - T_i). This multiplies the response of a mode with pole p by
|Σ A_i exp(-p T_i)|, the residual vibration (N. C. Singer, W. P. Seering, "Preshaping Command Inputs to Reduce System
Vibration", J. Dyn. Syst. Meas. Control 112, 1990).

The convolution of a motion q is Σ A_i q(t - T_i); its derivatives are sums of the same kind. As the kinematics are nonlinear, the
rigid end effector deviates a little from its path where joint references are shaped. Where the motion along the path is shaped, the
end effector stays on it: the shaped profile Σ A_i σ((t - T_i) / T) is again a profile, over the longer duration T + T_n.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.errors import TrajectoryError, positive, times
from flexfmu.trajectories.jets import Jet, RealArray, checked_order
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.profiles import Profile, SmoothPiece
from flexfmu.trajectories.trajectory import SAME_TIME, TaskTrajectory, Trajectory, merged

SUM_ROUNDING = 1e-9
"""Largest deviation of the amplitudes' sum from 1 that counts as rounding of published amplitudes."""

SAME_IMPULSE = 1e-12
"""Fraction of the duration within which two impulses of a convolution coincide."""


@dataclass(frozen=True)
class Oscillator:
    """A vibration mode x'' + 2 ζ ω x' + ω² x = 0.

    Attributes:
        frequency: undamped natural frequency ω / 2π [Hz].
        ratio: damping ratio ζ, 0 ≤ ζ < 1.

    Raises:
        TrajectoryError: the frequency isn't positive, or the ratio not from 0 to below 1.
    """

    frequency: float
    ratio: float = 0.0

    def __post_init__(self) -> None:
        positive("natural frequency", self.frequency, "Hz")
        checked_ratio(self.ratio)

    @property
    def angular_frequency(self) -> float:
        """ω [rad/s]."""
        return 2.0 * math.pi * self.frequency

    @property
    def damped_period(self) -> float:
        """2π / (ω sqrt(1 - ζ²)) [s]."""
        return 1.0 / (self.frequency * math.sqrt(1.0 - self.ratio**2))

    def decay(self, time: float) -> float:
        """Return the factor exp(-ζ ω t) by which the amplitude decays in a time t [s]."""
        return math.exp(-self.ratio * self.angular_frequency * time)


def checked_ratio(ratio: float) -> float:
    """Return a damping ratio; raise TrajectoryError unless 0 ≤ ratio < 1."""
    if not 0.0 <= ratio < 1.0:
        raise TrajectoryError(f"damping ratio must be at least 0 and below 1 (it has to vibrate), got {ratio:g}")
    return float(ratio)


def checked_fraction(name: str, value: float) -> float:
    """Return a number; raise TrajectoryError unless it is above 0 and below 1."""
    if not 0.0 < value < 1.0:
        raise TrajectoryError(f"{name} must be above 0 and below 1 (0.05 is 5 %), got {value:g}")
    return float(value)


@dataclass(frozen=True)
class ImpulseSequence:
    """Impulses A_i at times T_i, the first at 0. The amplitudes add up to 1, so that a shaped motion keeps its end point.

    Attributes:
        times: T_i [s], ascending from 0.
        amplitudes: A_i, negative ones allowed.

    Raises:
        TrajectoryError: times and amplitudes differ in number, the times don't ascend from 0, or the amplitudes don't add up
            to 1.
    """

    times: tuple[float, ...]
    amplitudes: tuple[float, ...]

    def __post_init__(self) -> None:
        instants, amplitudes = _numbers("times", self.times), _numbers("amplitudes", self.amplitudes)
        if len(instants) != len(amplitudes) or not instants:
            raise TrajectoryError(
                f"an impulse sequence needs as many times as amplitudes, at least one; got {len(instants)} and {len(amplitudes)}"
            )
        # the first impulse starts the motion
        if instants[0] != 0.0 or any(a >= b for a, b in pairwise(instants)):
            raise TrajectoryError(f"impulse times must start at 0 and ascend, got {_listed(instants)} s")
        # published amplitudes are rounded: normalise their sum
        total = math.fsum(amplitudes)
        if not abs(total - 1.0) <= SUM_ROUNDING * max(1.0, math.fsum(map(abs, amplitudes))):
            raise TrajectoryError(
                f"impulse amplitudes must add up to 1, or the motion ends elsewhere; {_listed(amplitudes)} add up to {total:.9g}"
            )
        object.__setattr__(self, "times", instants)
        object.__setattr__(self, "amplitudes", tuple(amplitude / total for amplitude in amplitudes))

    @property
    def duration(self) -> float:
        """Time of the last impulse [s], by which shaping lengthens a motion."""
        return self.times[-1]

    def residual(self, frequency: ArrayLike, ratio: float = 0.0) -> RealArray:
        """Return the residual vibration after the last impulse, relative to that of a single impulse at time 0.

        V = exp(-ζ ω T_n) sqrt(C² + S²) with C = Σ A_i exp(ζ ω T_i) cos(ω sqrt(1-ζ²) T_i), S likewise with the sine
        (Singer and Seering, "Preshaping Command Inputs to Reduce System Vibration", J. Dyn. Syst. Meas. Control 112,
        1990, eq. 10).

        Args:
            frequency: natural frequencies [Hz], zero or positive, a number or shape (N,).
            ratio: damping ratio ζ.

        Returns:
            V, shape (N,).
        """
        frequency = np.atleast_1d(np.asarray(frequency, dtype=float))
        bad = np.flatnonzero(~(np.isfinite(frequency) & (frequency >= 0.0)))
        if bad.size:
            raise TrajectoryError(
                f"frequencies must be zero or positive and finite, got {frequency[bad[0]]:g} Hz at index {bad[0]}"
            )
        # decay relative to the last impulse, so that no exponent has a positive real part
        omega = 2.0 * np.pi * frequency
        pole = complex(checked_ratio(ratio), math.sqrt(1.0 - ratio**2))
        exponents = np.outer(omega, pole * np.array(self.times) - ratio * self.duration)
        return np.asarray(np.abs(np.exp(exponents) @ np.array(self.amplitudes)))

    def convolve(self, other: ImpulseSequence) -> ImpulseSequence:
        """Return the convolution of both sequences, which cancels the modes of both; coinciding impulses are added."""
        # products of all pairs of impulses
        pairs = sorted(
            (t1 + t2, a1 * a2)
            for t1, a1 in zip(self.times, self.amplitudes, strict=True)
            for t2, a2 in zip(other.times, other.amplitudes, strict=True)
        )
        # add coinciding impulses
        near = SAME_IMPULSE * (self.duration + other.duration)
        instants, amplitudes = [pairs[0][0]], [pairs[0][1]]
        for time, amplitude in pairs[1:]:
            if time - instants[-1] <= near:
                amplitudes[-1] += amplitude
            else:
                instants.append(time)
                amplitudes.append(amplitude)
        return ImpulseSequence(tuple(instants), tuple(amplitudes))

    def split(self, sample_time: float) -> ImpulseSequence:
        """Return the sequence for a sampled signal: each impulse is split between the two samples around its time.

        The shares are linear in the distance (Murphy and Watanabe, "Digital Shaping Filters for Reducing Machine
        Vibration", IEEE Trans. Robotics and Automation 8, 1992). Moving each impulse to the nearest sample instead leaves ten
        to twenty times the residual.

        Args:
            sample_time: sample time of the signal [s].

        Raises:
            TrajectoryError: the sample time is not finite or not positive.
        """
        positive("sample time", sample_time, "s")
        shares: dict[int, float] = {}
        for time, amplitude in zip(self.times, self.amplitudes, strict=True):
            # an impulse within rounding of a sample belongs to that sample alone; impulses at the same sample are added
            position = time / sample_time
            sample = math.floor(position + SAME_IMPULSE * max(position, 1.0))
            later = max(position - sample, 0.0)
            for index, share in ((sample, 1.0 - later), (sample + 1, later)):
                if share:
                    shares[index] = shares.get(index, 0.0) + share * amplitude
        indices = sorted(shares)
        return ImpulseSequence(tuple(i * sample_time for i in indices), tuple(shares[i] for i in indices))


def _numbers(name: str, values: tuple[float, ...]) -> tuple[float, ...]:
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or not np.all(np.isfinite(array)):
        raise TrajectoryError(f"impulse {name} must be a sequence of finite numbers, got {values!r}")
    return tuple(float(value) for value in array)


def _listed(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.6g}" for value in values)


UNSHAPED = ImpulseSequence((0.0,), (1.0,))
"""One impulse at time 0, which leaves a motion unchanged."""


POINTS_ON_PATH = 2000
"""Points of the path among which the nearest one is searched first; 0.2 mm apart on a path of 0.4 m."""

POINTS_PER_INTERVAL = 60
"""Initial samples of the distance between two breakpoints."""

NEWTON_STEPS = 6
"""Newton steps to the foot of the perpendicular; convergence from 0.1 mm is quadratic and reaches rounding after four. The smallest
distance of all iterates counts, so that an overshooting step does no harm."""

FLATTEST = 0.1
"""Lower bound of the slope in Newton's method, relative to the slope of a straight path. It vanishes at a centre of curvature."""

REFINEMENTS = 6
"""Rounds of refinement; in each the neighbourhood of the largest distance shrinks to a quarter, at last to about a microsecond. The
error of the maximum is of the order of its square."""


@dataclass(frozen=True)
class ShapedTrajectory:
    """The shaped motion Σ A_i q(t - T_i) of a motion q.

    Attributes:
        trajectory: the motion q.
        sequence: impulses A_i at T_i.
    """

    trajectory: Trajectory
    sequence: ImpulseSequence

    @property
    def duration(self) -> float:
        """Duration of the motion [s]: the sum of the durations of q and of the sequence."""
        return self.trajectory.duration + self.sequence.duration

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times [s] at which a derivative may jump: the breakpoints of q, delayed by the time of each impulse."""
        shifted = [point + delay for delay in self.sequence.times for point in self.trajectory.breakpoints]
        return merged([0.0, self.duration], shifted, 0.5 * SAME_TIME * self.trajectory.duration)

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """Return the coordinates and their time derivatives, (order + 1, N, 2); see `flexfmu.trajectories.Trajectory.evaluate`."""
        # all delays in one call, then the weighted sum
        delayed = times(time) - np.array(self.sequence.times)[:, np.newaxis]
        parts = self.trajectory.evaluate(delayed.ravel(), checked_order(order), side)
        parts = parts.reshape(order + 1, *delayed.shape, parts.shape[-1])
        return np.asarray(np.einsum("i,kinc->knc", np.array(self.sequence.amplitudes), parts))


def path_deviation(motion: Trajectory, path: PickAndPlacePath | Trajectory) -> float:
    """Return the largest distance [m] between the end effector and the nearest point of the path.

    Args:
        motion: motion of the end effector, x and y [m].
        path: the planned path, or a motion along it.
    """
    from scipy.spatial import cKDTree  # here, since most motions need no scipy

    # points of the path and their derivatives by arc length, or by time
    if isinstance(path, PickAndPlacePath):
        places = np.linspace(0.0, path.length, POINTS_ON_PATH)
    else:
        places = np.unique(np.concatenate([np.linspace(0.0, path.duration, POINTS_ON_PATH), path.breakpoints]))

    def points(place: RealArray, order: int) -> RealArray:
        """Return points of the path and their derivatives (order + 1, N, 2) at places (N,)."""
        if isinstance(path, PickAndPlacePath):
            return np.stack([jet.derivatives() for jet in path.jets(place, order)], axis=-1)
        return path.evaluate(place, order)

    tree = cKDTree(points(places, 0)[0])

    def distances(positions: RealArray) -> RealArray:
        """Return the distances (N,) [m] of positions (N, 2) [m] from the path, by Newton's method from the nearest sample."""
        distance, index = tree.query(positions)
        place = places[index]
        for _ in range(NEWTON_STEPS):
            point, tangent, curvature = points(place, 2)
            # at the foot of the perpendicular, offset and tangent are orthogonal
            offset = point - positions
            distance = np.minimum(distance, np.linalg.norm(offset, axis=-1))
            steepness = np.sum(tangent**2, axis=-1)
            slope = np.maximum(steepness + np.sum(offset * curvature, axis=-1), FLATTEST * steepness)
            # at a standstill there is no direction to go
            step = np.sum(offset * tangent, axis=-1) / np.where(slope > 0.0, slope, np.inf)
            place = np.clip(place - step, 0.0, places[-1])
        return np.asarray(distance)

    # largest distance among the samples
    spans = [np.linspace(a, b, POINTS_PER_INTERVAL, endpoint=False) for a, b in pairwise(motion.breakpoints)]
    time = np.concatenate([*spans, [motion.duration]])
    distance = distances(motion.evaluate(time, 0)[0])
    worst = int(np.argmax(distance))
    # refine around it
    low, high = time[max(worst - 1, 0)], time[min(worst + 1, len(time) - 1)]
    largest = float(distance[worst])
    for _ in range(REFINEMENTS):
        grid = np.linspace(low, high, 9)
        found = distances(motion.evaluate(grid, 0)[0])
        best = int(np.argmax(found))
        largest = max(largest, float(found[best]))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, 8)]
    return largest


BACKWARDS = 1e-9
"""Relative speed; a negative speed along the path of more than this is motion backwards, below it rounding."""

SPEED_SAMPLES, SPEED_REFINEMENTS = 65, 3
"""Samples of the speed between two joins, and rounds in which the grid is refined around its minimum."""


def shape_along_path(task: TaskTrajectory, sequence: ImpulseSequence) -> TaskTrajectory:
    """Return the motion along the same path with the shaped profile; it is longer by the duration of the sequence.

    Raises:
        TrajectoryError: negative impulses make the motion go backwards along its path.
    """
    # delays T_i and duration T as fractions of the longer duration, so that the last delayed motion ends at 1 exactly
    profile, duration = task.profile, task.duration + sequence.duration
    delays = [time / duration for time in sequence.times]
    share = 1.0 - delays[-1]

    def shifted(fractions: Sequence[float]) -> list[float]:
        return [delay + share * fraction for delay in delays for fraction in fractions]

    # between two joins of the delayed profiles the sum has the same terms
    joins = shifted([edge for piece in profile.pieces for edge in (piece.start, piece.end)])
    pieces = []
    for start, end in pairwise(merged([0.0, 1.0], joins)):
        # a delayed motion has not begun, is in progress, or is finished
        terms, done = [], 0.0
        for delay, amplitude in zip(delays, sequence.amplitudes, strict=True):
            inside = (0.5 * (start + end) - delay) / share
            if 0.0 < inside < 1.0:
                terms.append((amplitude, delay, next(p for p in profile.pieces if inside <= p.end)))
            done += amplitude * (inside >= 1.0)
        # the profile ends at 1, independent of the rounding of the amplitudes' sum
        if end == 1.0:
            done = 1.0 - sum(amplitude for amplitude, _, _ in terms)
        pieces.append(_Sum(start, end, tuple(terms), done, share))
    if min(sequence.amplitudes) < 0.0:
        _check_direction(pieces, duration)
    jumps = merged([0.0, 1.0], shifted([0.0, *profile.jumps, 1.0]))[1:-1]
    return TaskTrajectory(task.path, Profile(tuple(pieces), jumps), duration)


@dataclass(frozen=True)
class _Sum:
    """A piece of the shaped profile between two joins: Σ A_i σ((η - delay_i) / share) + done.

    Attributes:
        start, end: fractions of the longer duration.
        terms: for each delayed motion in progress: amplitude, delay as a fraction of the longer duration, piece of σ.
        done: sum of the amplitudes of finished delayed motions.
        share: duration of σ as a fraction of the longer one.
    """

    start: float
    end: float
    terms: tuple[tuple[float, float, SmoothPiece], ...]
    done: float
    share: float

    def jet(self, eta: RealArray, order: int) -> Jet:
        """See `SmoothPiece.jet`."""
        total = Jet.constant(np.full(eta.shape, self.done), order)
        for amplitude, delay, piece in self.terms:
            total += amplitude * piece.jet((eta - delay) / self.share, order).rescale(1.0 / self.share)
        return total

    def value(self, eta: float) -> float:
        """See `SmoothPiece.value`."""
        return self.done + sum(a * piece.value((eta - delay) / self.share) for a, delay, piece in self.terms)


def _check_direction(pieces: Sequence[SmoothPiece], duration: float) -> None:
    """Raise TrajectoryError for a negative speed anywhere along the path."""
    for piece in pieces:
        # smallest speed of a piece, on grids refined around it
        eta = np.linspace(piece.start, piece.end, SPEED_SAMPLES)
        for _ in range(SPEED_REFINEMENTS):
            slowest = int(np.argmin(piece.jet(eta, 1).coefficients[1]))
            eta = np.linspace(eta[max(slowest - 1, 0)], eta[min(slowest + 1, SPEED_SAMPLES - 1)], SPEED_SAMPLES)
        speeds = piece.jet(eta, 1).coefficients[1]
        slowest = int(np.argmin(speeds))
        if speeds[slowest] < -BACKWARDS:
            raise TrajectoryError(
                f"the shaper's negative impulses make the motion go backwards along its path at t = {eta[slowest] * duration:.4g} s "
                f"(relative speed {speeds[slowest]:.3g}): shape the joint references, or choose a shaper with positive impulses"
            )

"""Shaping the motion along the path: the profile is shaped, so that the end effector keeps to the geometric path.

The shaped profile Σ A_i σ((t - T_i) / T) is a profile again, over the longer duration T + T_n. Between two joins of any of
the shifted profiles it is smooth, and its pieces are sums of theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import Jet, RealArray
from flexfmu.trajectories.profiles import Profile, SmoothPiece
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.trajectory import TaskTrajectory, merged

BACKWARDS = 1e-9
"""Slowest relative speed along the path that counts as going backwards, not as rounding."""

SAMPLES, REFINEMENTS = 65, 3
"""Points between two joins at which the speed is evaluated, and rounds in which the grid around its minimum is refined."""


@dataclass(frozen=True)
class ShapedProfile:
    """Σ A_i σ((t - T_i) / T) over the fraction of the longer duration T + T_n.

    Attributes:
        profile: σ.
        sequence: impulses A_i at T_i.
        duration: duration T of the motion that is shaped [s].

    Raises:
        TrajectoryError: negative impulses make the motion go backwards, which a motion along a path can't.
    """

    profile: Profile
    sequence: ImpulseSequence
    duration: float

    def __post_init__(self) -> None:
        positive("trajectory duration", self.duration, "s")
        if min(self.sequence.amplitudes) < 0.0:
            self._check_direction()

    @cached_property
    def pieces(self) -> tuple[SmoothPiece, ...]:
        """Sums of shifted pieces between all shifted joins."""
        # between two joins the same shifted pieces are under way
        joins = self._shifted([edge for piece in self.profile.pieces for edge in (piece.start, piece.end)])
        pieces = []
        for start, end in pairwise(merged([0.0, 1.0], joins)):
            # a shifted motion is under way, over, or has not begun
            terms, done = [], 0.0
            for delay, amplitude in zip(self._delays, self.sequence.amplitudes, strict=True):
                inside = (0.5 * (start + end) - delay) / self._share
                if 0.0 < inside < 1.0:
                    terms.append((amplitude, delay, next(p for p in self.profile.pieces if inside <= p.end)))
                done += amplitude * (inside >= 1.0)
            # the end is 1 to the last bit but one, whatever the amplitudes' sum is rounded to
            if end == 1.0:
                done = 1.0 - sum(amplitude for amplitude, _, _ in terms)
            pieces.append(_Sum(start, end, tuple(terms), done, self._share))
        return tuple(pieces)

    @cached_property
    def jumps(self) -> tuple[float, ...]:
        """Fractions at which a derivative of some order jumps: shifted starts, ends and jumps."""
        points = merged([0.0, 1.0], self._shifted([0.0, *self.profile.jumps, 1.0]))
        return points[1:-1]

    @property
    def _delays(self) -> list[float]:
        """T_i as fractions of the longer duration."""
        return [time / (self.duration + self.sequence.duration) for time in self.sequence.times]

    @property
    def _share(self) -> float:
        """T as a fraction of the longer duration; the last impulse's motion ends at 1 exactly."""
        return 1.0 - self._delays[-1]

    def _shifted(self, fractions: Sequence[float]) -> list[float]:
        return [delay + self._share * fraction for delay in self._delays for fraction in fractions]

    def _check_direction(self) -> None:
        """Refuse a negative speed anywhere along the path."""
        for piece in self.pieces:
            # the smallest speed of a piece, surrounded by a finer grid in every round
            eta = np.linspace(piece.start, piece.end, SAMPLES)
            for _ in range(REFINEMENTS):
                slowest = int(np.argmin(piece.jet(eta, 1).derivatives()[1]))
                eta = np.linspace(eta[max(slowest - 1, 0)], eta[min(slowest + 1, SAMPLES - 1)], SAMPLES)
            speeds = piece.jet(eta, 1).derivatives()[1]
            slowest = int(np.argmin(speeds))
            speed = float(speeds[slowest])
            if speed < -BACKWARDS:
                time = float(eta[slowest]) * (self.duration + self.sequence.duration)
                raise TrajectoryError(
                    f"the shaper's negative impulses make the motion go backwards along its path at t = {time:.4g} s "
                    f"(relative speed {speed:.3g}): shape the joint references, or choose a shaper with positive impulses"
                )


@dataclass(frozen=True)
class _Sum:
    """Σ A_i σ((η - delay_i) / share) + what is done, between two joins.

    Attributes:
        start, end: fractions of the longer duration.
        terms: amplitude, delay as a fraction of the longer duration, and the piece of σ that is under way.
        done: sum of the amplitudes whose motion is over.
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


def shape_along_path(task: TaskTrajectory, sequence: ImpulseSequence) -> TaskTrajectory:
    """The same path, run through with the shaped motion s(t); longer by the sequence's duration."""
    profile = ShapedProfile(task.profile, sequence, task.duration)
    return TaskTrajectory(task.path, profile, task.duration + sequence.duration)

"""Shaped motion profiles: the motion along the path is shaped, so that the end effector stays on the geometric path.

The shaped profile Σ A_i σ((t - T_i) / T) is again a profile, over the longer duration T + T_n. Its pieces are sums of pieces of
the delayed profiles, between the joins of all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError, positive
from flexfmu.trajectories.jets import Jet, RealArray
from flexfmu.trajectories.profile_pieces import SmoothPiece
from flexfmu.trajectories.profiles import Profile
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.trajectory import TaskTrajectory, merged

BACKWARDS = 1e-9
"""Relative speed; a negative speed along the path of more than this is motion backwards, below it rounding."""

SAMPLES, REFINEMENTS = 65, 3
"""Samples of the speed between two joins, and rounds in which the grid is refined around its minimum."""


@dataclass(frozen=True)
class ShapedProfile:
    """The shaped profile Σ A_i σ((t - T_i) / T) as a function of the fraction of the longer duration T + T_n.

    Attributes:
        profile: σ.
        sequence: impulses A_i at T_i.
        duration: duration T of the unshaped motion [s].

    Raises:
        TrajectoryError: the duration is not positive, or negative impulses make the motion go backwards along its path.
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
        """Sums of delayed pieces, between the joins of all delayed profiles."""
        # between two joins the sum has the same terms
        joins = self._shifted([edge for piece in self.profile.pieces for edge in (piece.start, piece.end)])
        pieces = []
        for start, end in pairwise(merged([0.0, 1.0], joins)):
            # a delayed motion has not begun, is in progress, or is finished
            terms, done = [], 0.0
            for delay, amplitude in zip(self._delays, self.sequence.amplitudes, strict=True):
                inside = (0.5 * (start + end) - delay) / self._share
                if 0.0 < inside < 1.0:
                    terms.append((amplitude, delay, next(p for p in self.profile.pieces if inside <= p.end)))
                done += amplitude * (inside >= 1.0)
            # the profile ends at 1, independent of the rounding of the amplitudes' sum
            if end == 1.0:
                done = 1.0 - sum(amplitude for amplitude, _, _ in terms)
            pieces.append(_Sum(start, end, tuple(terms), done, self._share))
        return tuple(pieces)

    @cached_property
    def jumps(self) -> tuple[float, ...]:
        """Fractions at which a derivative of some order jumps: delayed starts, ends and jumps of the profile."""
        points = merged([0.0, 1.0], self._shifted([0.0, *self.profile.jumps, 1.0]))
        return points[1:-1]

    @property
    def _delays(self) -> list[float]:
        """T_i as fractions of the longer duration."""
        return [time / (self.duration + self.sequence.duration) for time in self.sequence.times]

    @property
    def _share(self) -> float:
        """T as a fraction of the longer duration, computed so that the last delayed motion ends at 1 exactly."""
        return 1.0 - self._delays[-1]

    def _shifted(self, fractions: Sequence[float]) -> list[float]:
        return [delay + self._share * fraction for delay in self._delays for fraction in fractions]

    def _check_direction(self) -> None:
        """Raise TrajectoryError for a negative speed anywhere along the path."""
        for piece in self.pieces:
            # smallest speed of a piece, on grids refined around it
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


def shape_along_path(task: TaskTrajectory, sequence: ImpulseSequence) -> TaskTrajectory:
    """Return the motion along the same path with the shaped profile; it is longer by the duration of the sequence."""
    profile = ShapedProfile(task.profile, sequence, task.duration)
    return TaskTrajectory(task.path, profile, task.duration + sequence.duration)

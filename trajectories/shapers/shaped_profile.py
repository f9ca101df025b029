"""Shaping the motion along the path: the profile is shaped, so that the end effector keeps to the geometric path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.polynomial import Polynomial

from flexfmu.trajectories.checks import positive
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.profiles import Profile, ProfilePiece
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.shapers.shaped import merged
from flexfmu.trajectories.trajectory import SAME_TIME, TaskTrajectory

BACKWARDS = 1e-9
"""Slowest relative speed along the path that counts as going backwards, not as rounding."""


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
    def pieces(self) -> tuple[ProfilePiece, ...]:
        """Polynomials between all shifted joins."""
        joins = self._shifted([edge for piece in self.profile.pieces for edge in (piece.start, piece.end)])
        return tuple(self._piece(start, end) for start, end in pairwise(merged([0.0, 1.0], joins, SAME_TIME)))

    @cached_property
    def jumps(self) -> tuple[float, ...]:
        """Fractions at which a derivative of some order jumps: shifted starts, ends and jumps."""
        points = merged([0.0, 1.0], self._shifted([0.0, *self.profile.jumps, 1.0]), SAME_TIME)
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

    def _piece(self, start: float, end: float) -> ProfilePiece:
        """The sum between two neighbouring joins, expanded about the outer end or about its middle."""
        middle = 0.5 * (start + end)
        centre = 0.0 if start == 0.0 else 1.0 if end == 1.0 else middle
        total = Polynomial([0.0])
        for delay, amplitude in zip(self._delays, self.sequence.amplitudes, strict=True):
            total += amplitude * self._term((middle - delay) / self._share, (centre - delay) / self._share)
        if end == 1.0:
            total.coef[0] = 1.0
        return ProfilePiece(start, end, centre, tuple(float(c) for c in total.coef))

    def _term(self, inside: float, centre: float) -> Polynomial:
        """σ in the piece that contains the fraction ``inside``, expanded about ``centre`` and stretched."""
        if inside <= 0.0 or inside >= 1.0:
            return Polynomial([float(inside >= 1.0)])
        piece = next(piece for piece in self.profile.pieces if inside <= piece.end)
        return Polynomial(piece.coefficients)(Polynomial([centre - piece.centre, 1.0 / self._share]))

    def _check_direction(self) -> None:
        for piece in self.pieces:
            fraction, speed = _slowest(piece)
            if speed < -BACKWARDS:
                time = fraction * (self.duration + self.sequence.duration)
                raise TrajectoryError(
                    f"the shaper's negative impulses make the motion go backwards along its path at t = {time:.4g} s "
                    f"(relative speed {speed:.3g}): shape the joint references, or choose a shaper with positive impulses"
                )


def shape_along_path(task: TaskTrajectory, sequence: ImpulseSequence) -> TaskTrajectory:
    """The same path, run through with the shaped motion s(t); longer by the sequence's duration."""
    profile = ShapedProfile(task.profile, sequence, task.duration)
    return TaskTrajectory(task.path, profile, task.duration + sequence.duration)


def _slowest(piece: ProfilePiece) -> tuple[float, float]:
    """Fraction of the duration at which the speed of a piece is smallest, and that speed."""
    polynomial = Polynomial(piece.coefficients)
    turning = polynomial.deriv(2).roots()
    real = turning[np.abs(turning.imag) < SAME_TIME].real + piece.centre
    inside = real[(real > piece.start) & (real < piece.end)]
    fractions = np.concatenate([[piece.start, piece.end], inside])
    speeds = polynomial.deriv()(fractions - piece.centre)
    slowest = int(np.argmin(speeds))
    return float(fractions[slowest]), float(speeds[slowest])

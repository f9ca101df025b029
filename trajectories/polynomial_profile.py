"""The motion profile whose coefficients a user gives.

The polynomial is expanded about both ends, so that rounding errors are smallest there. What the given digits leave of σ(1) = 1 and
dσ/dη(1) = 0 is removed by a cubic, so that the motion ends where it should.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb, fsum, isfinite

import numpy as np

from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.profile_pieces import ProfilePiece

CLOSE = 1e-9
"""Largest error of σ(1) and dσ/dη(1): coefficients need ten digits where they aren't whole numbers."""

ROUNDING = 1e-9
"""Size of a coefficient of the speed, relative to the largest one, below which it is zero but for the given digits."""


@dataclass(frozen=True)
class PolynomialProfile:
    """A polynomial σ(η) = Σ c_k η^k from 0 to 1 with zero velocity at both ends, which always moves forward between them.

    Attributes:
        coefficients: c_k by ascending powers; c_0 = c_1 = 0.

    Raises:
        TrajectoryError: a coefficient isn't finite, an end isn't at rest or isn't reached, or the motion stops or goes
            backwards on its way.
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", tuple(float(c) for c in self.coefficients))
        self._check_ends()
        # forward in both halves: the speed without its zeros at the end is above zero
        for piece, direction in zip(self.pieces, (1.0, -1.0), strict=True):
            slowest = _slowest(piece.coefficients, direction)
            if slowest is not None:
                at = piece.centre + direction * slowest
                raise TrajectoryError(
                    f"{self._named()} stops or goes backwards at {at:.4g} of the duration; it must rise all the way"
                )

    @cached_property
    def pieces(self) -> tuple[ProfilePiece, ...]:
        """The polynomial twice: expanded about 0 for the first half, about 1 for the second."""
        # a cubic from rest to rest and one of the slope remove what the given digits leave at the end
        given = [*self.coefficients, *[0.0] * (4 - len(self.coefficients))]
        value, slope = (_coefficient_at_end(given, k) for k in (0, 1))
        given[2] += 3.0 * (1.0 - value) + slope
        given[3] -= 2.0 * (1.0 - value) + slope
        last = [1.0, 0.0, *(_coefficient_at_end(given, k) for k in range(2, len(given)))]
        return ProfilePiece(0.0, 0.5, 0.0, tuple(given)), ProfilePiece(0.5, 1.0, 1.0, tuple(last))

    @property
    def jumps(self) -> tuple[float, ...]:
        """None."""
        return ()

    def _check_ends(self) -> None:
        """Raise TrajectoryError unless the polynomial goes from rest at 0 to rest at 1."""
        given = self.coefficients
        if not all(map(isfinite, given)):
            raise TrajectoryError(f"{self._named()} must have finite coefficients")
        if len(given) < 3 or given[0] != 0.0 or given[1] != 0.0:
            raise TrajectoryError(
                f"{self._named()} must begin at rest: its first two coefficients must be 0, of ascending powers"
            )
        value, slope = (_coefficient_at_end(given, k) for k in (0, 1))
        if abs(value - 1.0) > CLOSE:
            raise TrajectoryError(
                f"{self._named()} must end at 1: its coefficients must have the sum 1, got {value:.8g}"
            )
        if abs(slope) > CLOSE:
            raise TrajectoryError(f"{self._named()} must end at rest: the sum of k c_k must be 0, got {slope:.4g}")

    def _named(self) -> str:
        return f"the profile with coefficients {list(self.coefficients)}"


def _coefficient_at_end(coefficients: Sequence[float], k: int) -> float:
    """Return the coefficient of (η - 1)^k from those of η^k."""
    return fsum(comb(j, k) * c for j, c in enumerate(coefficients))


def _slowest(coefficients: Sequence[float], direction: float) -> float | None:
    """Return the distance from an end, at most 0.5, at which the motion stops or goes backwards; None if it nowhere does.

    Args:
        coefficients: of the polynomial about this end.
        direction: 1 for the start of the motion, -1 for its end.
    """
    # speed by the distance from the end, without its zeros there
    speed = np.array([k * c * direction ** (k - 1) for k, c in enumerate(coefficients)][1:])
    begin = next(k for k, c in enumerate(speed) if abs(c) > ROUNDING * abs(speed).max())
    rest = np.polynomial.Polynomial(speed[begin:])
    # its smallest value is at an end of the half or where its slope is zero
    roots: list[complex] = rest.deriv().roots().astype(complex).tolist()
    inner = [root.real for root in roots if 0.0 < root.real < 0.5 and abs(root.imag) < ROUNDING]
    points = np.array([0.0, 0.5, *inner])
    values = rest(points)
    return None if values.min() > 0.0 else float(points[values.argmin()])

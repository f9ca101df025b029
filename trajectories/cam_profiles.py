"""Motion profiles of cam design: fifth-degree polynomial, harmonic, cycloidal, modified sine and modified trapezoid.

Each is symmetric about the middle. Peaks of dσ/dη and d²σ/dη² are given as C_v and C_a: a motion of length L in the time T has
the peak velocity C_v L/T and the peak acceleration C_a L/T².

Source: R. L. Norton, *Cam Design and Manufacturing Handbook*, 2nd edition, Industrial Press 2009, chapters 2 to 4.
"""

from __future__ import annotations

import math

from flexfmu.trajectories.profile_pieces import Piece, ProfilePiece, SinePiece, joins, symmetric

EIGHTH = 0.125
"""Fraction of the duration in which the acceleration of the modified profiles rises."""


class CamProfile:
    """A profile without parameters: two of a kind are equal. Without a dataclass, whose making takes longer than reading this file."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other)

    def __hash__(self) -> int:
        return hash(type(self))

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"


class Smooth(CamProfile):
    """A profile without a jump of any derivative between its ends."""

    @property
    def jumps(self) -> tuple[float, ...]:
        """None."""
        return ()


class FifthDegreePolynomial(Smooth):
    """Fifth-degree polynomial σ = 10 η³ - 15 η⁴ + 6 η⁵: velocity and acceleration are zero at both ends.

    C_v = 15/8, C_a = 10/√3 = 5.774; the jerk jumps by 60 at both ends.
    """

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The polynomial twice: expanded about 0 for the first half, about 1 for the second."""
        return symmetric(ProfilePiece(0.0, 0.5, 0.0, (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)))


class Harmonic(Smooth):
    """Simple harmonic motion σ = (1 - cos πη) / 2; C_v = π/2, C_a = π²/2 = 4.935, by which it jumps at both ends."""

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The cosine twice: about 0 for the first half, about 1 for the second."""
        return symmetric(SinePiece(0.0, 0.5, 0.0, 0.5, math.pi, integrals=2))


class Cycloidal(Smooth):
    """Cycloidal motion σ = η - sin(2πη) / 2π: the acceleration is one period of a sine; C_v = 2, C_a = 2π = 6.283."""

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The sine twice: about 0 for the first half, about 1 for the second."""
        return symmetric(SinePiece(0.0, 0.5, 0.0, 0.5 / math.pi, 2.0 * math.pi))


class ModifiedSine(CamProfile):
    """Modified sine: the acceleration is a quarter of a fast sine, half a slow one, a quarter of a fast one.

    C_v = 4π/(4 + π) = 1.760, C_a = 4π²/(4 + π) = 5.528; the peak of their product, of which the inertial power follows, is 5.46.
    """

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The sine of frequency 4π in the first and the last eighth, that of 4π/3 between them."""
        unit = 1.0 / (4.0 + math.pi)
        rise = SinePiece(0.0, EIGHTH, 0.0, 0.25 * unit, 4.0 * math.pi)
        slow = 4.0 * math.pi / 3.0
        middle = SinePiece(EIGHTH, 1.0 - EIGHTH, 0.5, -2.25 * unit, slow, coefficients=(0.5, 4.0 * math.pi * unit))
        return symmetric(rise, middle=middle)

    @property
    def jumps(self) -> tuple[float, ...]:
        """The joins of the sines, where the fourth derivative jumps."""
        return joins(self.pieces)


class ModifiedTrapezoid(CamProfile):
    """Modified trapezoid: the acceleration is a trapezoid whose flanks are quarters of a sine.

    C_v = 2, C_a = 8π/(2 + π) = 4.888.
    """

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Sine, parabola, half a sine about the middle, parabola, sine."""
        # acceleration A sin 4πη in the first eighth, and what it has led to at its end
        acceleration = 8.0 * math.pi / (2.0 + math.pi)
        amplitude = 0.5 / (math.pi * (2.0 + math.pi))
        rise = SinePiece(0.0, EIGHTH, 0.0, amplitude, 4.0 * math.pi)
        reached = amplitude * (0.5 * math.pi - 1.0), 2.0 / (2.0 + math.pi), 0.5 * acceleration
        plateau = ProfilePiece(EIGHTH, 3.0 * EIGHTH, EIGHTH, reached)
        # half a sine through zero
        flank = SinePiece(3.0 * EIGHTH, 5.0 * EIGHTH, 0.5, -amplitude, 4.0 * math.pi, coefficients=(0.5, 2.0))
        return symmetric(rise, plateau, middle=flank)

    @property
    def jumps(self) -> tuple[float, ...]:
        """The ends of the flanks, where the fourth derivative jumps."""
        return joins(self.pieces)

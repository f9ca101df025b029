"""Communication steps that keep a given error of the coupling: step doubling with rollback."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf

from flexfmu.cosim.errors import InputError

SAFETY = 0.8
"""The next step aims at this fraction of what the estimate allows, so that few are rejected."""

SHRINK, GROW = 0.2, 4.0
"""Limits for the change of the step from one to the next."""


@dataclass(frozen=True)
class StepDoubling:
    """Every step is taken twice, at once and in two halves; the difference estimates the error of the coupling.

    The two halves are kept. The error that accumulates over the whole run shall stay below the tolerance: a step of
    length h may add the fraction h / (stop - start) of it (error per unit step; E. Hairer, S. P. Nørsett, G. Wanner,
    Solving Ordinary Differential Equations I, II.4). What a slave keeps to itself is not
    seen: one that gives no output derivatives should put out velocities beside positions. The slaves' own integrators
    should be more precise than the tolerance, or their noise drives the step down.

    Args:
        tolerance: allowed error relative to the largest magnitude of each signal so far.
        absolute: allowed error on top of that, in each signal's unit (the derivatives' in unit/s).
        smallest: smallest step [s], two of which are taken at once; 1e-6 of the first one when None.
        largest: largest step [s].
        signals: outputs whose error counts, as ``slave.output``, with their first derivatives where the slave gives
            them. None for those that slaves with extrapolated or interpolated inputs pass on; for all continuous outputs
            of such a slave where it passes on none or gives no derivatives.
    """

    tolerance: float = 1e-4
    absolute: float = 1e-9
    smallest: float | None = None
    largest: float = inf
    signals: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not (0.0 < self.tolerance < 1.0 and 0.0 <= self.absolute < inf):
            raise InputError(
                f"step control needs 0 < tolerance < 1 and absolute ≥ 0, got {self.tolerance} and {self.absolute}"
            )
        if not 0.0 < (self.largest if self.smallest is None else self.smallest) <= self.largest:
            raise InputError(
                f"step control needs 0 < smallest ≤ largest step, got {self.smallest} s and {self.largest} s"
            )

    def least(self, first: float) -> float:
        """Smallest step [s], given the first one."""
        return min(1e-6 * first, self.largest) if self.smallest is None else self.smallest

    def next_step(self, step: float, error: float, order: int) -> float:
        """The step after one of length ``step`` [s] with that error.

        Args:
            step: [s].
            error: estimated error over allowed error.
            order: power of the step that the error per unit step goes with.
        """
        factor = SAFETY * float(error) ** (-1.0 / order) if error > 0.0 else GROW
        return min(step * min(max(factor, SHRINK), GROW), self.largest)


def fitted(step: float, remaining: float) -> float:
    """The step shortened so that equal steps end exactly after ``remaining`` [s]."""
    count = ceil(remaining / step * (1.0 - 1e-9))
    return remaining / max(count, 1)

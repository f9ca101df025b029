"""Communication steps that keep a given error of the coupling: step doubling with rollback."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, inf

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray

SAFETY = 0.9
"""The next step aims at this fraction of what the estimate allows, so that few are rejected."""

SHRINK, GROW = 0.2, 4.0
"""Limits for the change of the step from one to the next."""

AIM = 0.9
"""Part of the tolerance that is shared out."""

LEAST_LEFT = 0.2
"""Fraction of the tolerance that is shared out even when it has been used up."""

GROWTH_SHARE = 0.25
"""Part of the tolerance that may be used up while signals grow from nothing to their magnitudes."""

MINIMUM_FADING = 2.0
"""Errors that fade more slowly than this over the time elapsed may as well be ones that cancel by chance."""


@dataclass(frozen=True)
class StepDoubling:
    """Every step is taken twice, at once and in two halves; the difference estimates the error of the coupling.

    The two halves are kept. Beside them a second solution goes on in the long steps alone: its distance shows what has
    accumulated of the error, which shall stay below the tolerance over the whole run. Steps may add what is left of it,
    shared out over the remaining time (error per unit step; E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary
    Differential Equations I, II.4), and anew as far as the system forgets, see `ErrorBudget`. Where slaves sample, the
    second solution begins anew at every sample, so that errors count as if they never faded.

    What a slave keeps to itself is not seen: one that gives no output derivatives should output velocities beside
    positions. The slaves' own integrators should be more precise than the tolerance, or their noise drives the step down.

    Args:
        tolerance: allowed error relative to each signal's largest magnitude so far, no less than a third of that of the
            slave's others with the same unit, nor, for a rate, than what changes its signal once in the run.
        absolute: allowed error on top of that, in each signal's unit (the derivatives' in unit/s).
        smallest: smallest step [s], two of which are taken at once; 1e-6 of the first one when None.
        largest: largest step [s].
        signals: outputs whose error counts, as ``slave.output``. None for those that slaves with extrapolated or
            interpolated inputs pass on, with their first derivatives; for all continuous outputs of such a slave where
            it passes on none or gives no derivatives. Of these, what an input with an error enters at once, such as a
            spring's force or an acceleration, follows from the others and doesn't count.
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


class ErrorBudget:
    """How much a step may add to the error, so that no more than the tolerance has accumulated at any time.

    All errors are fractions of the tolerance. What is left of it is shared out over the remaining time, as in control of
    the error per unit step, and anew as far as the system forgets: with E the error that is there and S the sum of what
    the steps have added, E' = S' - E / tau gives the time tau in which errors fade. A signal that grows allows the
    corresponding fraction more.

    Args:
        start, stop: of the run [s].

    Attributes:
        span: length of the run [s].
    """

    def __init__(self, start: float, stop: float) -> None:
        self.span = stop - start
        self._start, self._stop, self._time = start, stop, start
        self._made = self._present = self._integral = self._carried = self._fading = 0.0
        self._rising = 1.0

    def allowed(self, begin: float, end: float, grown: RealArray) -> RealArray:
        """(n,) what a step from begin to end [s] may add.

        Args:
            begin, end: [s].
            grown: (n,) by which fraction the signals' magnitudes have grown in it.
        """
        left = max(AIM - self._present, LEAST_LEFT)
        share = (end - begin) * (1.0 / (self._stop - begin) + self._fading)
        return left / self._rising * np.minimum(share + GROWTH_SHARE * grown, 1.0)

    def spend(self, step: float, added: float, accumulated: float) -> None:
        """Take note of a step.

        Args:
            step: its length [s].
            added: what it has added.
            accumulated: the error at its end that has come up since `carry`.
        """
        forgets = exp(-self._fading * step)
        self._time += step
        self._carried *= forgets
        error = self._carried + accumulated
        self._made += added
        self._integral += error * step
        # oscillating errors pass through zero
        self._present = max(error, self._present * forgets)
        if self._made > 0.0:
            self._rising = max(self._rising, error / self._made)
        if self._integral > 0.0:
            apparent = (self._made - error) / self._integral
            self._fading = max(apparent - MINIMUM_FADING / (self._time - self._start), 0.0)

    def carry(self) -> None:
        """What comes up from now on is counted anew, on top of what is there."""
        self._carried = self._present

"""Step size control for a given tolerance of the coupling error: step doubling with rollback."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, inf

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray

SAFETY = 0.9
"""Safety factor of the next step relative to the optimal one, so that few steps are rejected."""

SHRINK, GROW = 0.2, 4.0
"""Least and largest ratio of a step to the one before."""

AIM = 0.9
"""Fraction of the tolerance that the steps may use."""

LEAST_LEFT = 0.2
"""Fraction of the tolerance that is available to the steps even when it has been used up."""

GROWTH_SHARE = 0.25
"""Fraction of the tolerance that may be used while signals grow from zero to their magnitudes."""

MINIMUM_FADING = 2.0
"""Least decay rate of errors that counts, times the elapsed time: a slower decay may be a chance cancellation."""


@dataclass(frozen=True)
class StepDoubling:
    """Step doubling: every step is taken as a whole and in two halves; the difference estimates the coupling error.

    The two halves are kept. A second solution takes the whole steps only; its difference from the first estimates the
    accumulated error, which shall stay below the tolerance over the whole run. Each step may add its share of the
    remaining tolerance (error per unit step; E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential
    Equations I, II.4), and more if errors decay in the system, see `ErrorBudget`. With sampled slaves the second
    solution restarts at every sample, so that errors count as if they never decayed.

    Internal states of slaves are not monitored: a slave without output derivatives should output velocities as well as
    positions. The errors of the slaves' own integrators should be smaller than the tolerance, else they reduce the
    step.

    Args:
        tolerance: allowed error relative to each signal's magnitude: its largest absolute value so far, but at least a
            third of the largest of the slave's signals with the same unit; for a rate also at least the magnitude of
            the signal itself divided by the length of the run.
        absolute: allowed error in addition, in each signal's unit (for derivatives in unit/s).
        smallest: smallest whole step [s], of which the halves are kept; 1e-6 of the first one if None.
        largest: largest whole step [s].
        signals: outputs to monitor, as ``slave.output``. None for the connected outputs of slaves whose inputs are
            extrapolated or interpolated, with their first derivatives; for all continuous outputs of such a slave if
            none is connected or it gives no derivatives. Signals with direct feedthrough from an input with an error
            (a spring's force, an acceleration) follow from the others and are left out.

    Raises:
        InputError: a tolerance or a limit of the step is out of range.
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
        """Smallest step [s] of a run whose first step has the length ``first`` [s]."""
        return min(1e-6 * first, self.largest) if self.smallest is None else self.smallest

    def next_step(self, step: float, error: float, order: int) -> float:
        """Length of the next step, or of the repeated one [s].

        Args:
            step: length of the step just taken [s].
            error: estimated error relative to the allowed error.
            order: power of the step to which the error per unit step is proportional.
        """
        factor = SAFETY * float(error) ** (-1.0 / order) if error > 0.0 else GROW
        return min(step * min(max(factor, SHRINK), GROW), self.largest)


def fitted(step: float, remaining: float) -> float:
    """The step [s], shortened so that equal steps end exactly after ``remaining`` [s]."""
    count = ceil(remaining / step * (1.0 - 1e-9))
    return remaining / max(count, 1)


class ErrorBudget:
    """Allowed error of each step, such that the accumulated error stays below the tolerance at any time.

    All errors are relative to the tolerance. The remaining tolerance is distributed over the remaining time (control of
    the error per unit step). If errors decay in the system, the steps may add more, at the rate of the decay: the
    accumulated error E and the sum S of the steps' errors satisfy E' = S' - E / tau, which gives the time constant tau
    of the decay. A signal whose magnitude grows in a step may add more, in proportion to its growth.

    Args:
        start, stop: begin and end of the run [s].

    Attributes:
        span: length of the run [s].
    """

    def __init__(self, start: float, stop: float) -> None:
        self.span = stop - start
        self._start, self._stop, self._time = start, stop, start
        self._made = self._present = self._integral = self._carried = self._fading = 0.0
        self._rising = 1.0

    def allowed(self, begin: float, end: float, grown: RealArray) -> RealArray:
        """(n,) allowed error of each signal in a step from ``begin`` to ``end``, relative to the tolerance.

        Args:
            begin, end: of the step [s].
            grown: (n,) fraction by which each signal's magnitude has grown in the step.
        """
        # share of the step in the remaining time, and in the decay of errors
        left = max(AIM - self._present, LEAST_LEFT)
        share = (end - begin) * (1.0 / (self._stop - begin) + self._fading)
        return left / self._rising * np.minimum(share + GROWTH_SHARE * grown, 1.0)

    def spend(self, step: float, added: float, accumulated: float) -> None:
        """Account for an accepted step.

        Args:
            step: its length [s].
            added: its own error.
            accumulated: the error at its end that has accumulated since the last `carry`.
        """
        # accumulated error, and sum of the steps' errors
        forgets = exp(-self._fading * step)
        self._time += step
        self._carried *= forgets
        error = self._carried + accumulated
        self._made += added
        self._integral += error * step
        # errors that oscillate pass through zero: let the estimate decrease only as fast as errors decay
        self._present = max(error, self._present * forgets)
        # amplification and decay of errors in the system
        if self._made > 0.0:
            self._rising = max(self._rising, error / self._made)
        if self._integral > 0.0:
            apparent = (self._made - error) / self._integral
            self._fading = max(apparent - MINIMUM_FADING / (self._time - self._start), 0.0)

    def carry(self) -> None:
        """Start a new count of the accumulated error, added to the present one."""
        self._carried = self._present

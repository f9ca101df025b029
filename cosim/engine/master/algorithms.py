"""How slaves are coupled over a communication step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from flexfmu.cosim.engine.master.iteration import Anderson, LoopSolver, Tolerance


class Algorithm(Protocol):
    """What the master needs to know about a coupling algorithm."""

    @property
    def solver(self) -> LoopSolver | None:
        """How the signals at the end of a step are found where slaves feed each other; None: they are extrapolated."""

    def interpolates(self, ahead: bool) -> bool:
        """Whether an input interpolates between both ends of a step.

        Args:
            ahead: whether its source is advanced before it.
        """


@dataclass(frozen=True)
class GaussSeidel:
    """One slave after the other, sources first: inputs from slaves that have been advanced interpolate, those that
    close a loop extrapolate."""

    @property
    def solver(self) -> None:
        """Nothing is repeated."""

    def interpolates(self, ahead: bool) -> bool:
        """Where the source is ahead."""
        return ahead


@dataclass(frozen=True)
class Jacobi:
    """All slaves side by side: every input extrapolates from the beginning of the step, so that the order of the slaves
    doesn't matter."""

    @property
    def solver(self) -> None:
        """Nothing is repeated."""

    def interpolates(self, ahead: bool) -> bool:
        """Nowhere."""
        return False


@dataclass(frozen=True)
class Implicit:
    """Slaves that feed each other repeat the step until the signals at its end agree: every input interpolates, and
    stiff couplings stay stable.

    With k derivatives of the signals the order is 2k + 2. An input that takes no derivatives is held at the mean of
    both ends, which has order 2. Needs slaves that can save and restore their state.

    Args:
        solver: how the signals at the end of the step are found. Its tolerance should be above the noise of the slaves'
            own integrators.
    """

    solver: LoopSolver = field(default_factory=lambda: Anderson(tolerance=Tolerance(relative=1e-8)))

    def interpolates(self, ahead: bool) -> bool:
        """Everywhere."""
        return True

"""Coupling algorithms: how inputs behave over a communication step, and whether the step is iterated."""

from __future__ import annotations

from dataclasses import dataclass, field

from flexfmu.cosim.engine.master.iteration import Anderson, LoopSolver, Tolerance


@dataclass(frozen=True)
class Algorithm:
    """A coupling algorithm, as the master uses it; steps aren't iterated unless the algorithm has a solver."""

    @property
    def iteration(self) -> LoopSolver | None:
        """Solver for the signals at the end of a step in closed loops of slaves; None if steps aren't iterated."""
        return None

    def interpolates(self, ahead: bool) -> bool:
        """Whether an input is interpolated between both ends of a step, else extrapolated from its beginning.

        Args:
            ahead: whether the source is stepped before the target.
        """
        return ahead


@dataclass(frozen=True)
class GaussSeidel(Algorithm):
    """Steps one slave after the other, sources first.

    An input is interpolated if its source has been stepped already; the inputs that close a loop are extrapolated.
    """


@dataclass(frozen=True)
class Jacobi(Algorithm):
    """Steps all slaves with inputs extrapolated from the beginning of the step; their order doesn't matter."""

    def interpolates(self, ahead: bool) -> bool:
        """False: every input is extrapolated."""
        return False


@dataclass(frozen=True)
class Implicit(Algorithm):
    """Iterates the step of slaves in a closed loop until the signals at its end agree; stiff couplings stay stable.

    Every input is interpolated. With k derivatives of the signals the order is 2k + 2. An input that takes no
    derivatives is held at the mean of both ends, which has order 2. The slaves in the loop must be able to save and
    restore their state.

    Args:
        solver: solves for the signals at the end of the step. Its tolerance should be larger than the error of the
            slaves' own integrators.
    """

    solver: LoopSolver = field(default_factory=lambda: Anderson(tolerance=Tolerance(relative=1e-8)))

    @property
    def iteration(self) -> LoopSolver:
        """The solver."""
        return self.solver

    def interpolates(self, ahead: bool) -> bool:
        """True: every input is interpolated."""
        return True

"""Solvers for loops of signals: find v with G(v) = v, where G evaluates the slaves once round the loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray

Round = Callable[[RealArray], RealArray]
"""v (n,) → G(v) (n,)."""


@dataclass(frozen=True)
class IterationResult:
    """Result of an iteration, converged or not.

    Attributes:
        value: (n,) the last v at which G was evaluated.
        residual: (n,) G(v) - v.
        allowed: (n,) the largest residuals that count as zero.
        rounds: number of evaluations of G.
    """

    value: RealArray
    residual: RealArray
    allowed: RealArray
    rounds: int

    @property
    def converged(self) -> bool:
        """Whether every residual counts as zero."""
        return bool((abs(self.residual) <= self.allowed).all())

    @property
    def worst(self) -> int:
        """Index of the largest residual relative to the allowed one."""
        return int(np.argmax(abs(self.residual) / self.allowed))


@dataclass(frozen=True)
class Tolerance:
    """When a residual counts as zero: at most relative * magnitude + absolute, in the signal's unit."""

    relative: float = 1e-10
    absolute: float = 1e-12

    def __post_init__(self) -> None:
        if not (0.0 <= self.relative < 1.0 and 0.0 < self.absolute < np.inf):
            raise InputError(
                f"a loop's tolerances must be relative 0..1 and absolute > 0, got {self.relative} and {self.absolute}"
            )

    def allowed(self, scale: RealArray, *values: RealArray) -> RealArray:
        """(n,) largest residuals that count as zero; never zero themselves, thanks to the absolute tolerance."""
        magnitude = np.maximum.reduce([scale, *map(abs, values)])
        return np.asarray(self.relative * magnitude + self.absolute)


@dataclass(frozen=True, kw_only=True)
class LoopSolver(ABC):
    """Finds v with G(v) = v. The solution that it returns is the last v at which it evaluated G.

    Args:
        tolerance: when a residual counts as zero.
        rounds: maximum number of rounds.
    """

    tolerance: Tolerance = Tolerance()
    rounds: int = 100

    def __post_init__(self) -> None:
        if self.rounds < 1:
            raise InputError(f"a loop needs at least one round to be solved, got {self.rounds}")

    def solve(self, around: Round, guess: RealArray, scale: RealArray) -> IterationResult:
        """Iterate until the residuals count as zero, or the maximum number of rounds is reached.

        Args:
            around: the function G.
            guess: (n,) initial v.
            scale: (n,) largest magnitudes of the signals so far, for the relative tolerance; zero if there are none.
        """
        value = guess
        rounds: list[IterationResult] = []
        for count in range(1, self.rounds + 1):
            passed = around(value)
            solution = IterationResult(value, passed - value, self.tolerance.allowed(scale, value, passed), count)
            if solution.converged:
                break
            rounds.append(solution)
            value = self._next(rounds)
        return solution

    @abstractmethod
    def _next(self, rounds: list[IterationResult]) -> RealArray:
        """The next v (n,) after these rounds, of which none has converged."""


@dataclass(frozen=True)
class FixedPoint(LoopSolver):
    """Fixed-point iteration v ← v + relaxation * (G(v) - v).

    Converges if |1 - relaxation * (1 - g)| < 1 for every eigenvalue g of G's Jacobian: without relaxation (1) for
    loop gains below one, with 0 < relaxation < 1 also for larger negative gains.

    Args:
        relaxation: above zero, at most one.
    """

    relaxation: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.relaxation <= 1.0:
            raise InputError(f"the relaxation must be above 0 and at most 1, got {self.relaxation}")
        super().__post_init__()

    def _next(self, rounds: list[IterationResult]) -> RealArray:
        return rounds[-1].value + self.relaxation * rounds[-1].residual


@dataclass(frozen=True)
class Anderson(LoopSolver):
    """Anderson's acceleration: a quasi-Newton method that estimates the Jacobian from the last rounds.

    D. G. Anderson, J. ACM 12 (1965) 547; H. F. Walker and P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715, eq. (2.1).
    A linear loop of n signals is solved in at most n + 2 rounds, whatever its gain, if depth ≥ n.

    Args:
        depth: number of last rounds that the estimate uses.
    """

    depth: int = 8
    rounds: int = field(default=50, kw_only=True)

    def __post_init__(self) -> None:
        if self.depth < 1:
            raise InputError(f"the depth of Anderson's acceleration must be at least 1, got {self.depth}")
        super().__post_init__()

    def _next(self, rounds: list[IterationResult]) -> RealArray:
        """The linear model of G through the last rounds, where its residual is smallest (least squares)."""
        last = rounds[-self.depth - 1 :]
        value, residual, allowed = last[-1].value, last[-1].residual, last[-1].allowed
        if len(last) == 1:
            return np.asarray(value + residual)
        value_steps = np.diff(np.stack([each.value for each in last]), axis=0).T
        residual_steps = np.diff(np.stack([each.residual for each in last]), axis=0).T
        # weights make residuals of different units comparable; unit columns keep the least-squares problem well conditioned
        weighted = residual_steps / allowed[:, None]
        lengths = np.linalg.norm(weighted, axis=0)
        lengths[lengths == 0.0] = 1.0
        share = np.linalg.lstsq(weighted / lengths, residual / allowed, rcond=None)[0] / lengths
        return np.asarray(value + residual - (value_steps + residual_steps) @ share)

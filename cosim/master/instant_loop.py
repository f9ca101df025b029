"""An algebraic loop in a run: solved at every instant by passing signals round it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexfmu.cosim.master.activity import Activity
from flexfmu.cosim.master.loop_signals import LoopSignals
from flexfmu.cosim.master.state import StateKeeper
from flexfmu.cosim.master.system import AlgebraicLoop
from flexfmu.cosim.master.visit import Visit
from flexfmu.cosim.slave import RealArray, SamplesInTwoPhases

REMEDY = (
    "solve it with Anderson() or with FixedPoint(relaxation=0.5) or less, allow more rounds or a larger tolerance, "
    "or put a slave with a state or a sample time into it"
)


class InstantLoop:
    """Solves one loop.

    Args:
        loop: the loop.
        visits: the turns of its slaves on a round.
        signals: its unknowns.
        activity: who is at work.
    """

    def __init__(self, loop: AlgebraicLoop, visits: Sequence[Visit], signals: LoopSignals, activity: Activity) -> None:
        self._loop = loop
        self._visits = visits
        self._signals = signals
        self._activity = activity

    def reset(self) -> None:
        """Forget the solutions of a run before."""
        self._signals.reset()

    def solve(self, point: int, time: float) -> None:
        """Pass signals round until they agree; who samples at this point is repeated from its state before.

        Raises:
            LoopError: the iteration has not converged.
        """
        repeated = [
            each.slave
            for each in self._visits
            if each.due and each.due[point] and not isinstance(each.slave, SamplesInTwoPhases)
        ]
        with StateKeeper(repeated) as states:

            def around(values: RealArray) -> RealArray:
                states.restore()
                return self._around(values, point, time)

            solution = self._loop.solver.solve(around, self._signals.gather(), self._signals.scale)
        self._signals.scatter(self._signals.accept(solution, self._loop.name, time, REMEDY))

    def _around(self, values: RealArray, point: int, time: float) -> RealArray:
        """One round with the unknowns assumed; what comes back."""
        passed = np.empty_like(values)
        self._signals.scatter(values)
        for visit in self._visits:
            self._activity.slave = visit.index
            visit.inputs.exchange()
            if visit.sample is not None and visit.due[point]:
                visit.sample(time)
            visit.outputs.read(time)
            self._signals.take(visit.outputs, passed)
            self._signals.scatter(values)
        return passed

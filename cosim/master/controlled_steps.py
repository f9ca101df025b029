"""Communication steps that are tried, judged, and taken back where their error is too large."""

from __future__ import annotations

from math import inf

import numpy as np

from flexfmu.cosim.errors import LoopError, SlaveError, StepSizeError
from flexfmu.cosim.master.coupling_error import CouplingError
from flexfmu.cosim.master.recorder import Recorder
from flexfmu.cosim.master.schedule import OFF_GRID, Schedule, Snapshot
from flexfmu.cosim.master.step_control import GROW, StepDoubling, fitted


class ControlledSteps:
    """Crosses the distance between two points of the grid in steps that keep a tolerance.

    Attributes:
        time: end of the last accepted step [s].
        accepted, rejected: steps so far; the two halves of an accepted one count as two.
        largest: largest accepted step [s].
    """

    def __init__(
        self, schedule: Schedule, recorder: Recorder, control: StepDoubling, error: CouplingError, first: float
    ) -> None:
        self.time = -inf
        self.accepted = self.rejected = 0
        self.largest = 0.0
        self._schedule = schedule
        self._recorder = recorder
        self._control = control
        self._error = error
        self._step = min(first, control.largest)
        self._least = control.least(first)

    def cross(self, begin: float, end: float) -> None:
        """Advance to ``end`` [s], all points between exchanged and recorded, the end itself not yet.

        Raises:
            StepSizeError: not even the smallest step keeps the tolerance.
            SlaveError: a slave fails even in the smallest step.
        """
        self.time = begin
        self._error.learn()
        while self.time < end:
            if self.time > begin:
                self._schedule.exchange(OFF_GRID, self.time, False)
                self._recorder.append(self.time)
            self._advance(end)
            self._error.learn()

    def _advance(self, end: float) -> None:
        """One step that keeps the tolerance, no further than ``end``."""
        wanted, rejected = self._step, self.rejected
        snapshot = self._schedule.save()
        with snapshot.states:
            while True:
                step = fitted(max(self._step, self._least), end - self.time)
                error = self._try(step, end, snapshot)
                proposal = self._control.next_step(step, error, self._error.order)
                if error <= 1.0:
                    break
                self.rejected += 1
                self._step = proposal
        shortened = self.rejected == rejected and proposal >= GROW * step
        self._step = max(proposal, wanted) if shortened else proposal
        self.time = end if step == end - self.time else self.time + step
        self.accepted += 2
        self.largest = max(self.largest, 0.5 * step)

    def _try(self, step: float, end: float, snapshot: Snapshot) -> float:
        """Take a step at once, then in two halves; its error over what is allowed. Taken back where that is above 1.

        A slave that fails, or a loop that isn't solved, may manage a smaller step: that too counts as a large error.
        """
        recorded = self._recorder.count
        try:
            error, worst = self._double(self.time, self.time + step if step < end - self.time else end, snapshot)
        except (SlaveError, LoopError):
            if step <= self._least:
                raise
            error, worst = inf, ""
        if error > 1.0:
            if step <= self._least:
                raise StepSizeError(self._complaint(worst, step, error))
            self._recorder.rewind(recorded)
            self._schedule.restore(snapshot)
        return error

    def _double(self, begin: float, end: float, snapshot: Snapshot) -> tuple[float, str]:
        """The step at once, back, and in two halves, of which the middle is recorded."""
        schedule, middle = self._schedule, begin + 0.5 * (end - begin)
        schedule.begin(np.array([begin, end]))
        schedule.advance(begin, end)
        schedule.refresh(end)
        at_once = self._error.signals()
        schedule.restore(snapshot)
        schedule.begin(np.array([begin, middle, end]))
        schedule.advance(begin, middle)
        schedule.exchange(OFF_GRID, middle, False)
        self._recorder.append(middle)
        schedule.advance(middle, end)
        schedule.refresh(end)
        return self._error.compare(at_once, end - begin)

    def _complaint(self, worst: str, step: float, error: float) -> str:
        """Why there is no smaller step."""
        return (
            f"the coupling error of {worst} is {error:.3g} times what the tolerance of {self._control.tolerance:g} allows "
            f"at {self.time:.9g} s, even with a step of {step:.3g} s; take a larger tolerance, a smaller smallest step, "
            f"or a higher precision within the slaves"
        )

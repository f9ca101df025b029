"""Communication steps that are tried, judged, and taken back where their error is too large.

Step doubling with rollback: a step is taken once as a whole and once in two halves. Their difference estimates the error of
the coupling by Richardson's extrapolation; `flexfmu.cosim.engine.master.step_control` says how much a step may add and
chooses the next one.
"""

from __future__ import annotations

from math import inf

import numpy as np

from flexfmu.cosim.engine.errors import LoopError, SlaveError, StepSizeError, WorkError
from flexfmu.cosim.engine.master.coupling_error import CouplingError
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import OFF_GRID, Schedule, Snapshot
from flexfmu.cosim.engine.master.step_control import GROW, ErrorBudget, StepDoubling, fitted
from flexfmu.cosim.engine.slave import RealArray

WORK_AT_START, WORK = 1e5, 100.0
"""So many steps may be made, and so many times those of the first one's length."""


class ControlledSteps:
    """Crosses the distance between two points of the grid in steps that keep a tolerance.

    Each step is taken at once and in two halves, which are kept: their distance is what the step adds to the error. A
    second solution goes on in long steps from mark to mark, never put right: its distance from the first is what the
    system has made of all errors since. (Both by Richardson's extrapolation.)

    Attributes:
        time: end of the last accepted step [s].
        accepted, rejected: steps so far; the two halves of an accepted one count as two.
        largest: largest accepted step [s].
    """

    def __init__(
        self,
        schedule: Schedule,
        recorder: Recorder,
        control: StepDoubling,
        error: CouplingError,
        first: float,
        budget: ErrorBudget,
    ) -> None:
        self.time = self._mark = -inf
        self.accepted = self.rejected = 0
        self.largest = 0.0
        self._schedule = schedule
        self._recorder = recorder
        self._control = control
        self._error = error
        self._budget = budget
        # length of the next step, the least one, and how many there may be
        self._step = min(first, control.largest)
        self._least = control.least(first)
        self._first, self._most = first, WORK_AT_START + WORK * budget.span / first
        # signals at the end of the last step, and states to go back to: of the run, and of the long steps
        self._signals = np.empty(0)
        self._short: Snapshot | None = None
        self._long: Snapshot | None = None

    def cross(self, begin: float, end: float) -> None:
        """Advance to ``end`` [s], all points between exchanged and recorded, the end itself not yet.

        Raises:
            StepSizeError: not even the smallest step keeps the tolerance.
            WorkError: far more steps than expected.
            SlaveError: a slave fails even in the smallest step.
        """
        # a mark: signals may have jumped, and their new magnitudes count
        self.time, self._mark = begin, begin
        if self.accepted == 0:
            self._error.start(self._schedule.inputs)
        self._signals = self._error.signals()
        self._error.learn(self._signals)
        try:
            self._short = self._schedule.save()
            # steps up to the point, exchanged and recorded between them
            while self.time < end:
                if self.time > begin:
                    if self._schedule.predicting:
                        self._schedule.exchange(OFF_GRID, self.time, False)
                    self._recorder.append(self.time)
                self._advance(end)
        finally:
            self._short = _replaced(self._short, None)
            if self._schedule.due:
                self.finish()

    def finish(self) -> None:
        """End the long steps: after the run, and where slaves sample, which have no saved states."""
        self._long = _replaced(self._long, None)
        self._budget.carry()

    def _advance(self, end: float) -> None:
        """One step that keeps the tolerance, no further than ``end``."""
        # smaller and smaller, until the error is small enough
        wanted, rejected = self._step, self.rejected
        while True:
            self._check_work(end)
            step = fitted(max(self._step, self._least), end - self.time)
            reached = self.time + step if step < end - self.time else end
            error, added = self._try(reached)
            proposal = self._control.next_step(step, error, self._error.order)
            if error <= 1.0:
                break
            self.rejected += 1
            self._step = proposal
        # what the step has added to the error of the run
        self._budget.spend(step, added, self._accumulated(reached, added, reached < end or not self._schedule.due))
        # a step that was shortened to end on the point says nothing against the length wanted before
        shortened = self.rejected == rejected and proposal >= GROW * step
        self._step = max(proposal, wanted) if shortened else proposal
        self.time = reached
        self.accepted += 2
        self.largest = max(self.largest, 0.5 * step)

    def _try(self, end: float) -> tuple[float, float]:
        """Take a step at once, then in two halves; what it adds to the error, over what it may add, and by itself. Taken
        back where it adds too much.

        A slave that fails, or a loop that isn't solved, may manage a smaller step: that too counts as a large error.
        """
        # the error of the worst signal; infinite where the step fails
        recorded, step, worst = self._recorder.count, end - self.time, ""
        error = added = inf
        try:
            errors, grown = self._double(end)
            ratios = errors / self._budget.allowed(self.time, end, grown)
            error, added = float(ratios.max(initial=0.0)), float(errors.max(initial=0.0))
            worst = self._error.name(int(np.argmax(ratios))) if ratios.size else ""
        except (SlaveError, LoopError):
            if step <= self._least:
                raise
        # back to the beginning, or give up
        if error > 1.0:
            if step <= self._least:
                raise StepSizeError(self._complaint(worst, step, error))
            self._recorder.rewind(recorded)
            self._restore(self._short)
        return error, added

    def _double(self, end: float) -> tuple[RealArray, RealArray]:
        """The step at once, back, and in two halves, of which the middle is recorded; how both differ."""
        schedule, begin = self._schedule, self.time
        # at once
        middle, at_once = begin + 0.5 * (end - begin), self._at_once(end, goes_on=False)
        self._restore(self._short)
        # in two halves
        schedule.begin(begin, middle, end)
        schedule.advance(begin, middle)
        schedule.exchange(OFF_GRID, middle, False)
        self._recorder.append(middle)
        schedule.advance(middle, end)
        schedule.refresh(end, self._error.following)
        self._signals = self._error.signals()
        return self._error.compare(self._signals, at_once)

    def _at_once(self, end: float, jump: bool = False, goes_on: bool = True) -> RealArray:
        """(n,) signals after one step, at whose beginning they may jump; whether another one follows from there."""
        self._schedule.begin(self.time, end, jump=jump)
        self._schedule.advance(self.time, end)
        if goes_on or self._error.following:
            self._schedule.refresh(end, self._error.following)
        return self._error.signals()

    def _accumulated(self, end: float, added: float, goes_on: bool) -> float:
        """The error since the last mark, at the end of a step that adds so much of it: the long steps go there too."""
        self._error.learn(self._signals)
        # where no second solution has begun or will go on, the step's own error is all there is
        before = self._long or self._short
        if before is self._short and not goes_on:
            return added
        schedule, kept = self._schedule, self._schedule.save()
        try:
            # the second solution, one long step further
            self._restore(before)
            long = self._at_once(end, jump=self.time == self._mark, goes_on=goes_on)
            self._long = _replaced(self._long, schedule.save() if goes_on else None)
        except (SlaveError, LoopError):
            # too long a step for them: they begin anew
            self._long, long = _replaced(self._long, None), None
            self._budget.carry()
        # back to the first solution, which the next step begins from
        self._short = _replaced(self._short, kept)
        self._restore(kept)
        return added if long is None else float(self._error.learned(self._signals, long).max(initial=0.0))

    def _restore(self, snapshot: Snapshot | None) -> None:
        """Go back."""
        if snapshot is not None:
            self._schedule.restore(snapshot)

    def _check_work(self, end: float) -> None:
        """Give up when the steps have become far more than those of the first one's length would be."""
        steps = self.accepted + self.rejected
        if steps > self._most:
            raise WorkError(
                f"step control has made {steps} steps up to {self.time:.9g} s, where the run goes on beyond {end:.9g} s, and "
                f"is at steps of {self._step:.3g} s: far more than steps of {self._first:.3g} s would be; take a larger "
                f"tolerance, derivatives of inputs and outputs or a softer coupling, a larger `minimum`, or a smaller first "
                f"step if so many are meant"
            )

    def _complaint(self, worst: str, step: float, error: float) -> str:
        """Why there is no smaller step."""
        return (
            f"the coupling error of {worst} is {error:.3g} times what the tolerance of {self._control.tolerance:g} allows "
            f"at {self.time:.9g} s, even with a step of {step:.3g} s; take a larger tolerance, a smaller smallest step, "
            f"or a higher precision within the slaves"
        )


def _replaced(old: Snapshot | None, new: Snapshot | None) -> Snapshot | None:
    """The new one, when the old one isn't needed any more."""
    if old is not None:
        old.states.release()
    return new

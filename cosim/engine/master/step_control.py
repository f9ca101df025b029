"""Step size control for a given tolerance of the coupling error: step doubling with rollback.

`CouplingError` estimates the error of a step, `ErrorBudget` says how much each step may add to what has accumulated over the run,
and `ControlledSteps` takes the steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, exp, inf

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError, LoopError, SlaveError, StepSizeError, WorkError
from flexfmu.cosim.engine.master.couplings import Coupling, Couplings, Transport
from flexfmu.cosim.engine.master.loops import StateKeeper
from flexfmu.cosim.engine.master.ports import InputPort, OutputPort
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.schedule import OFF_GRID, Schedule, Snapshot
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import Indices, PredictsOutputs, RealArray, Sampled, Slave, feedthrough

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

WORK_AT_START, WORK = 1e5, 100.0
"""Maximum number of steps: WORK_AT_START, plus WORK times the number of steps of the first one's length."""


@dataclass(frozen=True)
class StepDoubling:
    """Step doubling: every step is taken as a whole and in two halves; the difference estimates the coupling error.

    The two halves are kept. A second solution takes the whole steps only; its difference from the first estimates the
    accumulated error, which shall stay below the tolerance over the whole run. Each step may add its share of the
    remaining tolerance (error per unit step; E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential
    Equations I, II.4), and more if errors decay in the system, see `ErrorBudget`. With sampled slaves the second
    solution restarts at every sample, so that errors count as if they never decayed.

    Monitored are the connected outputs of slaves whose inputs are extrapolated or interpolated, with their first derivatives; all
    continuous outputs of such a slave if none is connected or it gives no derivatives. Signals with direct feedthrough from an input
    with an error (a spring's force, an acceleration) follow from the others and are left out. Internal states are not monitored: a slave without output derivatives should output velocities as well as
    positions. The errors of the slaves' own integrators should be smaller than the tolerance, else they reduce the
    step.

    Args:
        tolerance: allowed error relative to each signal's magnitude: its largest absolute value so far, but at least a
            third of the largest of the slave's signals with the same unit; for a rate also at least the magnitude of
            the signal itself divided by the length of the run.
        absolute: allowed error in addition, in each signal's unit (for derivatives in unit/s).
        smallest: smallest whole step [s], of which the halves are kept; 1e-6 of the first one if None.
        largest: largest whole step [s].

    Raises:
        InputError: a tolerance or a limit of the step is out of range.
    """

    tolerance: float = 1e-4
    absolute: float = 1e-9
    smallest: float | None = None
    largest: float = inf

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


NUDGE = 1e-6
"""Perturbation of an input, relative and absolute, that shows which output derivatives depend on it directly."""

PEERS = 1.0 / 3.0
"""Least magnitude of a signal relative to the largest of the same slave and unit.

Without it a velocity component that has hardly begun to change, say, would have too small a tolerance."""

TINY = float(np.finfo(np.float64).tiny)
"""Smallest denominator, so that 0 / 0 becomes 0."""


class CouplingError:
    """Estimates the coupling error of the monitored signals, relative to their tolerance.

    Attributes:
        order: power of the step to which the error per unit step is proportional.
        following: ports of monitored signals that may depend directly on inputs without a coupling error (from slaves
            that predict their outputs or sample); they are read again after these inputs have been set.
    """

    def __init__(self, schedule: Schedule, control: StepDoubling, span: float) -> None:
        self._control, self._span = control, span
        self._monitored = _monitored(schedule.system, schedule.outputs, schedule.couplings)
        self.order = 1 + min(map(_degree, filter(_counts, schedule.couplings.values())), default=0)
        self.following: list[OutputPort] = []

    def start(self, inputs: Sequence[InputPort]) -> None:
        """Monitor first derivatives too, except those that depend directly on an input with a coupling error.

        Velocities accumulate errors; accelerations follow from the inputs. The slaves must have been initialised and
        their inputs set.

        Args:
            inputs: input ports, in the order of `System.slaves`.
        """
        # ports that are read again after a step
        self.following = [
            port
            for slave, port, _ in self._monitored
            if any(not _errs(group.source.slave) for group in inputs[slave].groups)
        ]
        # flat indices of values and first derivatives in their ports; names; kinds: signals of one slave with the same unit,
        # in place of an unknown unit the name of the output, share a magnitude
        self._places: list[tuple[RealArray, Indices]] = []
        self._names: list[str] = []
        kinds: list[tuple[str, str]] = []
        for slave, port, columns in self._monitored:
            signals = [(0, column) for column in columns]
            if port.recorded > 1:
                entered = _entered_rates(inputs[slave], port)
                signals += [(1, column) for column in columns if not entered[column]]
            places = [row * port.indices.size + column for row, column in signals]
            self._places.append((port.signals.reshape(-1), np.array(places, np.intp)))
            for row, column in signals:
                owner, variable = port.slave.name, port.slave.variables[port.indices[column]]
                self._names.append(f"der({owner}.{variable.name},1)" if row else f"{owner}.{variable.name}")
                kinds.append((owner, (variable.unit or variable.name) + "/s" * row))
        known = list(dict.fromkeys(kinds))
        self._kind = np.array([known.index(kind) for kind in kinds], np.intp)
        rates = [
            (known.index((slave, unit + "/s")), i)
            for i, (slave, unit) in enumerate(known)
            if (slave, unit + "/s") in known
        ]
        # for each kind of rates: its index, and that of the kind it is the derivative of
        self._rates, self._changing = np.array(rates, np.intp).reshape(-1, 2).T
        self._of_kind, self._scale = np.zeros(len(known)), np.zeros(len(kinds))

    def signals(self) -> RealArray:
        """(n,) the current monitored signals."""
        found = [signals.take(places) for signals, places in self._places]
        return found[0] if len(found) == 1 else np.concatenate([np.empty(0), *found])

    def learn(self, signals: RealArray) -> None:
        """Update the magnitudes with the signals (n,).

        A signal's magnitude is its largest absolute value so far, but no less than `PEERS` times the largest of its
        kind (same slave and unit). A rate's magnitude is also at least the largest of the signals that it is the rate
        of, divided by the length of the run.
        """
        sizes, largest = abs(signals), self._of_kind
        np.maximum.at(largest, self._kind, sizes)
        np.maximum.at(largest, self._rates, largest[self._changing] / (PEERS * self._span))
        self._scale = np.maximum(np.maximum(self._scale, sizes), PEERS * largest[self._kind])

    def compare(self, short: RealArray, long: RealArray) -> tuple[RealArray, RealArray]:
        """(n,) error relative to the tolerance, and (n,) fraction by which the magnitude has grown since `learn`.

        Args:
            short: (n,) signals of the half steps.
            long: (n,) signals of the whole step.
        """
        scale = np.maximum(self._scale, abs(short))
        return self._over(abs(short - long), scale), 1.0 - self._scale / np.maximum(scale, TINY)

    def learned(self, short: RealArray, long: RealArray) -> RealArray:
        """(n,) error relative to the tolerance, as in `compare`, with the magnitudes of the last `learn`."""
        return self._over(abs(short - long), self._scale)

    def _over(self, differences: RealArray, scale: RealArray) -> RealArray:
        """(n,) Richardson's error estimate relative to the tolerance, for signals of magnitude ``scale``."""
        allowed = (2.0**self.order - 1.0) * (self._control.tolerance * scale + self._control.absolute)
        return differences / np.maximum(allowed, TINY)

    def name(self, signal: int) -> str:
        """Name of the monitored signal with this index."""
        return self._names[signal]


Monitored = list[tuple[int, OutputPort, Sequence[int]]]
"""Index of a slave, its output port, and the columns of the monitored outputs in the port's signals."""


def _monitored(system: System, ports: Sequence[OutputPort], couplings: Couplings) -> Monitored:
    """Monitored outputs of all slaves whose inputs have a coupling error.

    These are the continuous outputs that are connected; all continuous outputs if none is connected or the slave gives
    no derivatives. Outputs that depend directly on an input with a coupling error (a spring's force, say) follow from
    the others and are left out, unless no slave has others.
    """
    monitored: Monitored = []
    following: Monitored = []
    for i in sorted({target for (_, target), coupling in couplings.items() if _counts(coupling)}):
        port, variables = ports[i], ports[i].slave.variables
        # connected outputs
        used = {each.output for each in system.connections if each.source == i and port.recorded > 1}
        # inputs with an error, and outputs that depend directly on them
        erring = {
            variables[each.input].name
            for each in system.connections
            if each.target == i and _errs(system.slaves[each.source])
        }
        entered = {name for name, inputs in feedthrough(port.slave).items() if erring & set(inputs)}
        # continuous outputs; preferably those without direct feedthrough from inputs with an error
        columns = [
            k
            for k, index in enumerate(port.indices)
            if index in (used or port.indices) and not variables[index].discrete
        ]
        states = [k for k in columns if variables[port.indices[k]].name not in entered]
        (monitored if states else following).append((i, port, states or columns))
    return monitored or following


def _errs(source: Slave) -> bool:
    """Whether the slave's outputs can have a coupling error at communication points, as those of stepped slaves do."""
    return not isinstance(source, PredictsOutputs | Sampled)


def _entered_rates(inputs: InputPort, outputs: OutputPort) -> NDArray[np.bool_]:
    """(n,) whether the first derivative of each output depends directly on an input with a coupling error."""
    # perturb all inputs with an error and compare the derivatives
    before, fed = outputs.signals.copy(), inputs.fed.copy()
    with StateKeeper([inputs.slave]) as state:
        for group in inputs.groups:
            if _errs(group.source.slave):
                inputs.fed[0, group.slots] += NUDGE * (1.0 + abs(fed[0, group.slots]))
        inputs.send()
        outputs.transfer()
        entered: NDArray[np.bool_] = outputs.signals[1] != before[1]
        state.restore()
    # restore the buffers; the slave has been rolled back
    inputs.fed[:], outputs.signals[:] = fed, before
    return entered


def _counts(coupling: Coupling) -> bool:
    """Whether the coupling error depends on the communication step."""
    return coupling.transport in (Transport.EXTRAPOLATED, Transport.INTERPOLATED, Transport.AVERAGED)


def _degree(coupling: Coupling) -> int:
    """Degree of the polynomial that the coupling represents exactly; 1 for the mean of both ends."""
    if coupling.transport is Transport.AVERAGED:
        return 1
    return coupling.order if coupling.ends is None else 2 * coupling.ends + 1


class ControlledSteps:
    """Steps the slaves from one grid point to the next with a bounded coupling error.

    Each step is taken once as a whole and once in two halves; the halves are kept. Their difference estimates the local
    error; if it is too large, the slaves are rolled back and a smaller step is tried. A second solution takes the whole steps
    only and is never corrected. Its difference from the first solution estimates the error accumulated since it began. (Both by
    Richardson extrapolation.)

    Args:
        schedule: ports and order of calls.
        recorder: records every instant.
        control: tolerance and limits of the steps.
        first: length of the first step [s].

    Attributes:
        time: end of the last accepted step [s].
        accepted, rejected: number of steps so far; the two halves of an accepted step count as two.
        largest: largest accepted half step [s].
    """

    def __init__(self, schedule: Schedule, recorder: Recorder, control: StepDoubling, first: float) -> None:
        self.time = self._mark = -inf
        self.accepted = self.rejected = 0
        self.largest = 0.0
        self._schedule, self._recorder, self._control = schedule, recorder, control
        self._budget = ErrorBudget(schedule.grid.start, schedule.grid.stop)
        self._error = CouplingError(schedule, control, self._budget.span)
        # length of the next step, smallest step, and maximum number of steps
        self._step = min(first, control.largest)
        self._least = control.least(first)
        self._first, self._most = first, WORK_AT_START + WORK * self._budget.span / first
        # signals at the end of the last step, and snapshots to roll back to: of the run, and of the second solution
        self._signals = np.empty(0)
        self._short = Snapshot(StateKeeper(()), ())
        self._long: Snapshot | None = None

    def cross(self, begin: float, end: float) -> None:
        """Step from ``begin`` to ``end`` [s]; exchange and record at every point between them, not at the end.

        Raises:
            StepSizeError: the error exceeds the tolerance even with the smallest step.
            WorkError: the run has taken more steps than allowed.
            SlaveError: a slave fails even in the smallest step.
            LoopError: an iteration doesn't converge even in the smallest step.
        """
        # signals may have jumped at this point: include their new magnitudes
        self.time, self._mark = begin, begin
        if self.accepted == 0:
            self._error.start(self._schedule.inputs)
        self._signals = self._error.signals()
        self._error.learn(self._signals)
        try:
            self._short = self._schedule.save()
            # steps up to the point, with exchange and recording between them
            while self.time < end:
                if self.time > begin:
                    if self._schedule.predicting:
                        self._schedule.exchange(OFF_GRID, self.time, False)
                    self._recorder.append(self.time)
                self._advance(end)
        finally:
            self._short.states.release()
            if self._schedule.due:
                self.finish()

    def finish(self) -> None:
        """End the second solution: after the run, and at each grid point if slaves sample.

        The states of sampled slaves are not saved.
        """
        self._long = _replaced(self._long, None)
        self._budget.carry()

    def _advance(self, end: float) -> None:
        """Take one step that meets the tolerance, no further than ``end`` [s]."""
        # reduce the step until the error is small enough
        wanted, rejected = self._step, self.rejected
        while True:
            if (steps := self.accepted + self.rejected) > self._most:
                raise WorkError(
                    f"step control has made {steps} steps up to {self.time:.9g} s, where the run goes on beyond {end:.9g} s, and "
                    f"is at steps of {self._step:.3g} s: far more than steps of {self._first:.3g} s would be; take a larger "
                    f"tolerance, derivatives of inputs and outputs or a softer coupling, a larger `minimum`, or a smaller first "
                    f"step if so many are meant"
                )
            step = fitted(max(self._step, self._least), end - self.time)
            reached = self.time + step if step < end - self.time else end
            error, added = self._try(reached)
            proposal = self._control.next_step(step, error, self._error.order)
            if error <= 1.0:
                break
            self.rejected += 1
            self._step = proposal
        # update the error budget
        self._budget.spend(step, added, self._accumulated(reached, added, reached < end or not self._schedule.due))
        # after a step that was shortened only to end on the point, keep the length wanted before
        shortened = self.rejected == rejected and proposal >= GROW * step
        self._step = max(proposal, wanted) if shortened else proposal
        self.time = reached
        self.accepted += 2
        self.largest = max(self.largest, 0.5 * step)

    def _try(self, end: float) -> tuple[float, float]:
        """Take a step as a whole and in two halves; roll back if its error is too large.

        A failing slave or a loop that doesn't converge counts as an infinite error: a smaller step may succeed.

        Returns:
            The error relative to what the step may add (the largest of all signals), and relative to the tolerance.
        """
        # error of the worst signal; infinite if the step fails
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
        # too large: roll back, or give up at the smallest step
        if error > 1.0:
            if step <= self._least:
                raise StepSizeError(
                    f"the coupling error of {worst} is {error:.3g} times what the tolerance of {self._control.tolerance:g} allows "
                    f"at {self.time:.9g} s, even with a step of {step:.3g} s; take a larger tolerance, a smaller smallest step, "
                    f"or a higher precision within the slaves"
                )
            self._recorder.rewind(recorded)
            self._schedule.restore(self._short)
        return error, added

    def _double(self, end: float) -> tuple[RealArray, RealArray]:
        """Take the step as a whole, roll back, take it in two halves and record the middle.

        Returns:
            What `CouplingError.compare` returns for both.
        """
        schedule, begin = self._schedule, self.time
        # as a whole
        middle, at_once = begin + 0.5 * (end - begin), self._at_once(end, goes_on=False)
        self._schedule.restore(self._short)
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
        """Take a step as a whole; the signals (n,) at its end.

        Args:
            end: of the step [s].
            jump: whether signals may jump at its beginning.
            goes_on: whether another step continues from its end.
        """
        self._schedule.begin(self.time, end, jump=jump)
        self._schedule.advance(self.time, end)
        if goes_on or self._error.following:
            self._schedule.refresh(end, self._error.following)
        return self._error.signals()

    def _accumulated(self, end: float, added: float, goes_on: bool) -> float:
        """Continue the second solution to ``end`` [s]; the error accumulated since it began, relative to the tolerance.

        Args:
            end: of the step [s].
            added: the step's own error; returned where there is no second solution.
            goes_on: whether the second solution continues from ``end``.
        """
        self._error.learn(self._signals)
        # without a second solution, before or after this step, only the step's own error is known
        before = self._long or self._short
        if before is self._short and not goes_on:
            return added
        schedule, kept = self._schedule, self._schedule.save()
        try:
            # the second solution: one whole step further
            schedule.restore(before)
            long = self._at_once(end, jump=self.time == self._mark, goes_on=goes_on)
            self._long = _replaced(self._long, schedule.save() if goes_on else None)
        except (SlaveError, LoopError):
            # the step is too long for a slave or a loop: the second solution restarts
            self._long, long = _replaced(self._long, None), None
            self._budget.carry()
        # back to the first solution, from which the next step begins
        self._short.states.release()
        self._short = kept
        schedule.restore(kept)
        return added if long is None else float(self._error.learned(self._signals, long).max(initial=0.0))


def _replaced(old: Snapshot | None, new: Snapshot | None) -> Snapshot | None:
    """The new snapshot, after the states of the old one have been released."""
    if old is not None:
        old.states.release()
    return new

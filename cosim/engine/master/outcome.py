"""The result of a simulation: its outcome, a message in one line, the recording, and the delay of each connection with its cause; and
the detection of an unstable coupling.

Signals in closed loops may grow faster than the communication steps can resolve. A physical instability that the steps resolve
changes a signal by little from step to step. If the changes from step to step keep growing over many steps and are about as large as
the signal itself, the coupling is unstable (or can't be distinguished from an unstable one with this step). If a signal alternates
from step to step with growing amplitude, the gain of its loop is too high for the communication step or the sample time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from math import inf

import numpy as np

from flexfmu.cosim.engine.errors import LoopError, NotFiniteError, SlaveEnded, SlaveError, StepSizeError, WorkError
from flexfmu.cosim.engine.master.couplings import Couplings, Transport
from flexfmu.cosim.engine.master.schedule import sampling_positions
from flexfmu.cosim.engine.master.system import System, in_one_call
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.showing import few_lines, shorten
from flexfmu.cosim.engine.slave import RealArray, Sampled, offset

ROUNDING = 1e-9
"""Instants that differ by less than this fraction of a sample time coincide."""


@dataclass(frozen=True)
class SignalDelay:
    """Delay of a connection.

    Attributes:
        connection: ``plant.y -> controller.u``.
        seconds: greatest age of the signal at the target [s]: zero; the largest communication step of the run if it is
            extrapolated; or, between two sampled slaves, the time since the source's last sample.
        mean: the same on average over the samples of a sampled target [s].
        transport: how the target gets the signal.
        derivatives: number of derivatives that extrapolate the signal and compensate for its age.
        hold: sample time of a sampled source whose target is stepped [s]; half of it is delay on average.
        latency: delay of the source's output behind its inputs at low frequency [s], as of a dead time or a lag.
    """

    connection: str
    seconds: float
    transport: Transport
    derivatives: int
    hold: float = 0.0
    latency: float = 0.0
    mean: float = 0.0

    @property
    def average(self) -> float:
        """Total delay on average [s]: the latency, half of the hold, and the age.

        Of an extrapolated signal half the age counts, or nothing if derivatives are passed.
        """
        extrapolated = self.transport is Transport.EXTRAPOLATED
        age = self.seconds * (0.0 if self.derivatives else 0.5) if extrapolated else self.mean
        return self.latency + 0.5 * self.hold + age

    def __str__(self) -> str:
        """The delay in words, one line."""
        # sample and hold, no delay, an older sample, extrapolation
        if self.hold:
            way = (
                f"{0.5 * self.hold:.6g} s late on average, held for {self.hold:.6g} s between the samples of its source"
            )
        elif self.seconds == 0.0:
            way = f"no delay, {self.transport.value}"
        elif self.transport is not Transport.EXTRAPOLATED:
            more = f" on average, {self.seconds:.6g} s at most" if self.seconds > self.mean * (1.0 + ROUNDING) else ""
            way = f"{self.mean:.6g} s late{more}, its source has sampled that long before its target"
        elif self.derivatives:
            known = f"{self.derivatives} derivative{'s' if self.derivatives > 1 else ''}"
            way = f"up to {self.seconds:.6g} s old, {self.transport.value} with {known}"
        else:
            way = f"up to {self.seconds:.6g} s late, held over the step"
        own = f"; its source itself lags by {self.latency:.6g} s" if self.latency else ""
        return f"{self.connection}: {way}{own}"


def signal_delays(system: System, couplings: Couplings, step: float) -> tuple[SignalDelay, ...]:
    """The delay of each connection of the system, in their order.

    Args:
        system: slaves and connections.
        couplings: (source, target) → their coupling.
        step: the largest communication step [s].
    """
    positions, delays = sampling_positions(system), []
    for each in system.connections:
        coupling = couplings[each.source, each.target]
        source, target = system.slaves[each.source], system.slaves[each.target]
        seconds, mean, hold = step if coupling.transport is Transport.EXTRAPOLATED else 0.0, 0.0, 0.0
        # a source with given instants is never late; a sampled target may use an older sample; a stepped target sees it held
        if isinstance(source, Sampled) and source.sample_time < inf:
            if isinstance(target, Sampled):
                sampled_later = in_one_call(source) and positions[each.source] >= positions[each.target]
                apart = offset(target) - offset(source)
                seconds, mean = _ages(source.sample_time, target.sample_time, apart, sampled_later)
            else:
                hold = source.sample_time
        # latency of the source itself
        latency = getattr(source, "latency", {}).get(source.variables[each.output].name, 0.0)
        delays.append(
            SignalDelay(system.describe(each), seconds, coupling.transport, coupling.order, hold, latency, mean)
        )
    return tuple(delays)


COUNTED = 1000
"""Number of target instants compared; the pattern repeats within it, see `flexfmu.cosim.engine.master.grid`."""


def _ages(period: float, target_period: float, apart: float, late: bool) -> tuple[float, float]:
    """Longest and mean time between a sample of the target and the source's last sample before it [s].

    Args:
        period, target_period: sample times of source and target [s].
        apart: first sample instant of the target after that of the source [s].
        late: whether the source samples after the target when both sample at the same instant.
    """
    since = np.mod(apart + target_period * np.arange(COUNTED), period) / period
    together = (since < ROUNDING) | (since > 1.0 - ROUNDING)
    ages = period * np.where(together, 1.0 if late else 0.0, since)
    # the mean of whole patterns
    pattern = Fraction(period / target_period).limit_denominator(COUNTED).numerator
    return float(ages.max()), float(ages[:pattern].mean())


WINDOW = 8
"""Number of steps in a window: longer than the period of any oscillation that the steps don't resolve."""

WINDOWS = 4
"""Number of consecutive windows at the end of a run that must all show the growth."""

GROWTH = 2.0
"""Least growth factor of the largest change from window to window."""

UNRESOLVED = 0.5
"""Least value of a window's largest change from step to step, relative to its largest magnitude."""

TOTAL_GROWTH = 1e6
"""Least growth factor of the magnitude since the first tenth of the run: far beyond the overshoot of a stable loop."""


ALTERNATIONS = 5
"""Least number of consecutive changes of alternating sign, none smaller than the one before."""

ALTERNATING_GROWTH = 100.0
"""Least growth factor of these changes from first to last; its square root is the least factor in their second half,
since an instability grows exponentially, a resonance only linearly."""

BEYOND_PAST = 10.0
"""Least size of the last of these changes, relative to the signal's largest magnitude before them: beats of a vibration
fade and grow again, but not beyond it."""

FINAL_SHARE = 0.1
"""Least size of the last of these changes, relative to the signal's largest magnitude in the run: rounding errors
alternate, too."""


@dataclass(frozen=True)
class Instability:
    """A signal that shows an unstable coupling.

    Attributes:
        signal: its name, ``slave.output``.
        growth: mean factor by which its change grew from step to step.
        since: time at which it began to grow [s].
    """

    signal: str
    growth: float
    since: float


def find_instability(time: RealArray, signals: Iterable[tuple[str, RealArray]]) -> Instability | None:
    """The signal whose change from step to step grew fastest at the end of the run; None if none is unstable.

    Args:
        time: (N,) recorded instants [s]; of two equal ones the last counts.
        signals: (name, values (N,)) of signals in closed loops.
    """
    found, count = list[Instability](), WINDOW * WINDOWS
    for times, name, values in _right_limits(time, signals):
        if times.size <= count:
            continue
        # largest change and magnitude in each of the last windows
        change = abs(np.diff(values))[-count:].reshape(WINDOWS, WINDOW).max(axis=1)
        magnitude = abs(values[-count:]).reshape(WINDOWS, WINDOW).max(axis=1)
        # it grows from window to window, faster than the steps resolve, and far beyond its initial magnitude
        before = float(abs(values[: max(2, values.size // 10)]).max())
        grows = bool((change[1:] >= GROWTH * change[:-1]).all()) and change[0] > 0.0
        unresolved = bool((change >= UNRESOLVED * magnitude).all())
        if grows and unresolved and magnitude[-1] >= TOTAL_GROWTH * before:
            growth = float((change[-1] / change[0]) ** (1.0 / (count - WINDOW)))
            found.append(Instability(name, growth, float(times[np.argmax(abs(values) > 10.0 * before)])))
    return max(found, key=lambda each: each.growth, default=None)


def find_alternation(time: RealArray, signals: Iterable[tuple[str, RealArray]]) -> Instability | None:
    """The signal whose alternating change from step to step grew fastest; None if none is unstable.

    Args:
        time: (N,) recorded instants [s]; of two equal ones the last counts.
        signals: (name, values (N,)) of signals in closed loops, those of sampled slaves included.
    """
    found: list[Instability] = []
    for times, name, values in _right_limits(time, signals):
        # intervals with changes of alternating sign, none smaller than the one before
        change = np.diff(values)
        size = abs(change)
        follows = (change[1:] * change[:-1] < 0.0) & (size[1:] >= size[:-1])
        bounded = np.concatenate([[False], follows, [False]])
        edges = np.flatnonzero(bounded[1:] != bounded[:-1]).reshape(-1, 2)
        for begin, end in edges[edges[:, 1] - edges[:, 0] >= ALTERNATIONS - 1].tolist():
            # do they show an instability, or a vibration?
            total, late = size[end] / size[begin], size[end] / size[begin + (end - begin + 1) // 2]
            explodes = total >= ALTERNATING_GROWTH and late >= ALTERNATING_GROWTH**0.5
            exceeds_past = size[end] >= BEYOND_PAST * abs(values[: begin + 1]).max()
            if explodes and exceeds_past and size[end] >= FINAL_SHARE * abs(values).max():
                found.append(Instability(name, float(total) ** (1.0 / (end - begin)), float(times[begin + 1])))
    return max(found, key=lambda each: each.growth, default=None)


def _right_limits(
    time: RealArray, signals: Iterable[tuple[str, RealArray]]
) -> Iterator[tuple[RealArray, str, RealArray]]:
    """Instants, name and values of each signal, at the last of equal instants."""
    if found := list(signals):
        last = np.append(np.diff(time) > 0.0, np.ones(min(time.size, 1), dtype=np.bool_))
        times = time[last]
        yield from ((times, name, values[last]) for name, values in found)


class Outcome(Enum):
    """How a simulation ended; the value is a sentence for users."""

    COMPLETED = "the simulation reached its stop time"
    ENDED_BY_SLAVE = "a slave asked to end the simulation; the results end there"
    INITIALISATION_FAILED = "a slave could not be initialised; check its parameters and start values"
    STEP_FAILED = "a slave failed within a communication step; the results end before it"
    NOT_FINITE = "a slave's output became infinite or not a number; the results end before it"
    LOOP_NOT_SOLVED = "a loop of signals was not solved by its iteration; the results end before it"
    STEP_TOO_SMALL = "the smallest communication step doesn't keep the tolerance; the results end before it"
    TOO_MUCH_WORK = "the run took far more steps than its length allows; the results end where they led"
    COUPLING_UNSTABLE = "signals that go round between slaves grow faster than the communication step can resolve"
    LOOP_UNSTABLE = "the control loop is unstable; the results end where a slave could not follow any more"
    INTERRUPTED = "the simulation was interrupted; the results end there"

    @property
    def is_failure(self) -> bool:
        """Whether the run failed: neither its stop time nor a slave ended it."""
        return self not in (Outcome.COMPLETED, Outcome.ENDED_BY_SLAVE)


@dataclass(frozen=True, repr=False)
class Simulation:
    """Result of a run.

    Attributes:
        recording: the recorded outputs, named ``slave.variable``, up to the time that the run reached.
        outcome: how the run ended.
        message: what happened, in one line: the slave, the time, and the slave's message.
        error: the exception that ended the run; None if it reached its stop time or a slave asked to end it.
        steps: number of completed communication steps.
        rejected: number of steps that step control rolled back and repeated with a smaller length.
        delays: the delay of each connection.
    """

    recording: Recording
    outcome: Outcome
    message: str
    error: BaseException | None
    steps: int
    rejected: int
    delays: tuple[SignalDelay, ...]

    def __repr__(self) -> str:
        """Return at most five lines: how it went, and what was recorded."""
        head = f"Simulation: {self.steps} steps, {shorten(self.message, 50)}; recorded:"
        if self.error is not None:
            head = f"Simulation failed after {self.steps} steps: {self.message}"
        return few_lines(head, [*self.recording.columns])


def outcome_of(error: BaseException | None, initialized: bool) -> Outcome:
    """The outcome of a run that ended with this error.

    Args:
        error: the exception; None if the run reached its stop time.
        initialized: whether all slaves had been initialised.
    """
    if error is None:
        return Outcome.COMPLETED
    if isinstance(error, KeyboardInterrupt):
        return Outcome.INTERRUPTED
    kinds = {
        LoopError: Outcome.LOOP_NOT_SOLVED,
        StepSizeError: Outcome.STEP_TOO_SMALL,
        WorkError: Outcome.TOO_MUCH_WORK,
        NotFiniteError: Outcome.NOT_FINITE,
        SlaveEnded: Outcome.ENDED_BY_SLAVE,
    }
    # any other error, and any during initialisation
    other = Outcome.STEP_FAILED if initialized else Outcome.INITIALISATION_FAILED
    return next((kind for error_type, kind in kinds.items() if isinstance(error, error_type) and initialized), other)


def message_of(error: BaseException | None, outcome: Outcome, active: str, reached: float) -> str:
    """What happened, in one line.

    Args:
        error: the exception that ended the run, if any.
        outcome: of the run.
        active: name of the slave that was called last.
        reached: time that the run reached [s].
    """
    if error is None or isinstance(error, KeyboardInterrupt):
        return outcome.value
    if isinstance(error, LoopError | StepSizeError | WorkError):
        return " ".join(str(error).split())
    slave = error.slave if isinstance(error, SlaveError) else active
    reason = error.reason if isinstance(error, SlaveError) else f"{type(error).__name__}: {error}"
    if isinstance(error, SystemExit):
        # tblib, which Dask loads, makes errors pickle without their `code`
        code = repr(error.args[0]) if error.args else ""
        reason = f"it called sys.exit({code}); raise an exception to end a run"
    # the slave's own time, if it reports one
    known: float | None = getattr(error, "time", None)
    when = f" at {reached if known is None else known:.9g} s"
    if outcome is Outcome.ENDED_BY_SLAVE:
        return f"{slave} asked to end the simulation{when}: {' '.join(reason.split())}"
    return f"{slave} failed{'' if when in reason else when}: {' '.join(reason.split())}"


def blown_up(found: Instability, ending: str) -> str:
    """Message about a growing signal, in one line; ``ending`` is the message of the run's end, or empty."""
    return (
        f"{found.signal} grows {found.growth:.3g}-fold from step to step since {found.since:.9g} s: the coupling is unstable "
        f"(or the step far too coarse for the system); take a smaller communication step, Implicit() coupling, or slaves "
        f"with input and output derivatives{'; in the end ' + ending if ending else ''}"
    )


def overshot(found: Instability, fed: Iterable[str], ending: str) -> str:
    """Message about an alternating signal, in one line.

    Args:
        found: the signal.
        fed: names of the slaves that it feeds.
        ending: message of the run's end; empty if it reached its stop time.
    """
    return (
        f"{found.signal}, which goes to {', '.join(fed)}, jumps up and down {found.growth:.3g} times as far from step to step "
        f"since {found.since:.9g} s: the coupling is unstable; lower the gain of the loop, or take a smaller communication "
        f"step and sample time{'; in the end ' + ending if ending else ''}"
    )

"""What the master asks of a slave: a small protocol like FMI's, and further small ones for what only some can do.

Variables are addressed by their index in `Slave.variables`; names are looked up once, before a run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal, Protocol, runtime_checkable

from flexfmu.cosim.engine.errors import InputError
from flexfmu.trajectories.jets import Indices as Indices
from flexfmu.trajectories.jets import RealArray as RealArray

Causality = Literal["input", "output", "parameter"]
Type = Literal["Real", "Integer", "Boolean", "String", "Enumeration"]
Call = Callable[[], None]

TAKES: Mapping[Type, tuple[Type, ...]] = {
    "Real": ("Real", "Integer"),
    "Integer": ("Integer", "Enumeration"),
    "Boolean": ("Boolean",),
    "String": ("String",),
    "Enumeration": ("Enumeration", "Integer"),
}
"""Type of an input → types of the outputs that may feed it, as in SSP: nothing is rounded or guessed on the way."""

COINCIDENT = 1e-6
"""Instants nearer than this fraction of the communication step are one instant, that of the mark.

A mark (a knot of the trajectory, say) and a tick differ by rounding, about 1e-12 of a step after 1e5 of them; a step
of less than a millionth of the others would only cost time and digits."""


@dataclass(frozen=True)
class SlaveVariable:
    """A scalar variable that the master can connect, set or record.

    Attributes:
        name: name within the slave, for example ``joint1.torque``.
        causality: input, output or parameter.
        unit: unit, for example ``N.m``; empty when unknown, which fits every unit.
        start: start value in ``unit``; None when the slave calculates it.
        discrete: whether it changes in jumps alone, as counters and switches do.
        type: what its values are; a text is its code in `TEXTS`, all others are numbers.

    Raises:
        InputError: there is no such type.
    """

    name: str
    causality: Causality
    unit: str = ""
    start: float | None = None
    discrete: bool = False
    type: Type = "Real"

    def __post_init__(self) -> None:
        if self.type not in TAKES:
            raise InputError(f"{self.name} has the type {self.type!r}; a variable is one of {', '.join(TAKES)}")


class Texts:
    """Texts with a number each, so that signals of type String travel like all others.

    A code means the same text as long as the process lives, and in its child processes.
    """

    def __init__(self) -> None:
        self._codes: dict[str, int] = {}

    def code(self, text: str) -> float:
        """The number that stands for a text, a new one where it is new."""
        return float(self._codes.setdefault(text, len(self._codes)))

    def known(self) -> list[str]:
        """All texts, in the order of their codes."""
        return [*self._codes]

    def learn(self, texts: Iterable[str]) -> None:
        """Take over the texts of a child process."""
        for text in texts:
            self.code(text)


TEXTS = Texts()
"""The texts of this process."""


class Slave(Protocol):
    """Anything that can be initialised, fed, advanced and read."""

    @property
    def name(self) -> str:
        """Name within the system, without a dot."""

    @property
    def variables(self) -> Sequence[SlaveVariable]:
        """All variables; a variable's index here is its address in `set` and `get`."""

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Get ready for a run from ``start_time`` to ``stop_time`` [s]; inputs may have been set before."""

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs (n,) at the current time."""

    def get(self, indices: Indices, values: RealArray) -> None:
        """Write the variables' current values into ``values`` (n,)."""

    def step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s]; raise `SlaveError` (or any exception) on failure."""


@runtime_checkable
class TakesInputDerivatives(Protocol):
    """Within a step its inputs are polynomials u(t + tau) = sum of u_k tau^k / k!."""

    @property
    def max_input_order(self) -> int:
        """Highest derivative that is taken into account; 0 for none."""

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Set time derivatives (orders, n) of inputs, row k - 1 for order k, after their values."""


@runtime_checkable
class GivesOutputDerivatives(Protocol):
    """Knows time derivatives of its outputs at the current time."""

    @property
    def max_output_order(self) -> int:
        """Highest derivative that `get_derivatives` gives; 0 for none."""

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Write derivatives (orders, n) of outputs, row k - 1 for order k; at most ``max_output_order`` rows."""


@runtime_checkable
class LacksDerivatives(GivesOutputDerivatives, Protocol):
    """Gives fewer derivatives of some outputs than of others."""

    @property
    def lacking(self) -> Mapping[str, int]:
        """Output → lowest order of its derivatives that isn't given; outputs with all orders are left out."""


@runtime_checkable
class HasBreakpoints(Protocol):
    """Something jumps at instants that are known beforehand; the master lands on them exactly."""

    @property
    def breakpoints(self) -> Sequence[float]:
        """Instants [s], ascending, at which the outputs or their derivatives jump."""


@runtime_checkable
class PredictsOutputs(HasBreakpoints, Protocol):
    """Independent of its inputs: before a step it announces its outputs over that step as a polynomial.

    After `announce`, `get` and `get_derivatives` describe that polynomial at the beginning of the step (right limits);
    after `step` they give the left limits at its end.
    """

    @property
    def announced_order(self) -> int:
        """Degree of the announced polynomial."""

    @property
    def ends_exactly(self) -> bool:
        """Whether the announced polynomial ends in the outputs' left limits at the end of the step."""

    def prepare(self, times: RealArray) -> None:
        """Take note of the coming communication points (N,) [s] and go to the first of them, left limits.

        Before a run these are all of its points, as far as they are known. A master that chooses its steps on the way
        calls it again before every step; the first point may then be earlier than the current time.
        """

    def announce(self, time: float) -> None:
        """Change over to the step that begins at ``time``, one of the communication points."""


@runtime_checkable
class Sampled(Protocol):
    """Runs at its own instants start + offset + k * sample_time and holds its outputs in between; it is never stepped.

    The offset is zero but for slaves that are `HasOffset`.
    """

    @property
    def sample_time(self) -> float:
        """Sample time [s]."""

    def sample(self, time: float) -> None:
        """Calculate new outputs from the inputs just set, and move on to the next instant."""


@runtime_checkable
class HasOffset(Protocol):
    """Samples for the first time some time after the start; until then its outputs are as it was initialised."""

    @property
    def offset(self) -> float:
        """First sample instant after the start [s], zero or positive."""


@runtime_checkable
class SamplesInTwoPhases(Sampled, Protocol):
    """Can calculate its outputs before all inputs are known, as a discrete system y = C x + D u with zeros in D can.

    At a sample instant the master calls `output` once or more, then `update` once; `sample` does both.
    """

    def output(self, time: float) -> None:
        """Calculate outputs from the state and the inputs set so far; the state stays."""

    def update(self, time: float) -> None:
        """Calculate the next state from the inputs just set; the outputs stay."""


@runtime_checkable
class HasLatency(Protocol):
    """Knows by how much its outputs lag behind its inputs, as delays do; the list of delays says so."""

    @property
    def latency(self) -> Mapping[str, float]:
        """Name of an output → its delay at low frequency [s], without the hold between samples; left out where there is none."""


@runtime_checkable
class LimitsStep(Protocol):
    """Is stepped, no further at once than its signals are good polynomials."""

    @property
    def largest_step(self) -> float:
        """Largest communication step [s]; longer ones are divided."""


@runtime_checkable
class RatesFollowInputs(Protocol):
    """Its outputs are continuous where its inputs jump, their derivatives jump along: its exchange step comes when its
    inputs are up to date, but where that alone would close a loop."""

    @property
    def rates_follow_inputs(self) -> bool: ...


@runtime_checkable
class MayNeedRegularSteps(Protocol):
    """Is stepped, but perhaps by one and the same step length alone: an FMU that can't vary its communication step."""

    @property
    def needs_regular_steps(self) -> bool:
        """Whether all of its steps must have the same length."""


@runtime_checkable
class DeclaresFeedthrough(Protocol):
    """Knows which outputs depend on which inputs at the same instant; others are taken to depend on all."""

    @property
    def feedthrough(self) -> Mapping[str, Sequence[str]]:
        """Name of an output → names of the inputs it depends on algebraically; an output left out depends on all."""


@runtime_checkable
class SavesState(Protocol):
    """Can go back to an earlier state."""

    def save(self) -> object:
        """The complete state at the current time, inputs included."""

    def restore(self, state: object) -> None:
        """Go back to a state that `save` gave; may be repeated."""


@runtime_checkable
class MaySaveState(SavesState, Protocol):
    """Has `save` and `restore`, but can't always: an FMU only if its model description says so."""

    @property
    def can_save(self) -> bool:
        """Whether states can be saved."""


@runtime_checkable
class ReleasesStates(SavesState, Protocol):
    """Has saved states that take memory of their own."""

    def release(self, state: object) -> None:
        """Free a saved state, or keep its memory for the next one; it won't be restored again."""


@runtime_checkable
class BindsBuffers(Protocol):
    """Prepares repeated transfers between fixed variables and fixed buffers, which is faster than `get` and `set`.

    Buffers are C-contiguous; shapes as in `Slave.set`, `Slave.get`, `TakesInputDerivatives.set_derivatives` and
    `GivesOutputDerivatives.get_derivatives`. A call may be bound before the slave is initialised and serves all its runs;
    it is made only between `Slave.initialize` and the end of a run.
    """

    def bind_set(self, indices: Indices, values: RealArray) -> Call: ...
    def bind_get(self, indices: Indices, values: RealArray) -> Call: ...
    def bind_set_derivatives(self, indices: Indices, derivatives: RealArray) -> Call: ...
    def bind_get_derivatives(self, indices: Indices, derivatives: RealArray) -> Call: ...


@runtime_checkable
class Reports(Protocol):
    """Has something to say about a run that is over, also about one in another process.

    Attributes:
        remarks: what a user should know, a sentence each.
    """

    @property
    def remarks(self) -> Sequence[str]: ...
    def report(self) -> Mapping[str, Any]: ...
    def take_report(self, report: Mapping[str, Any]) -> None: ...


@runtime_checkable
class Terminates(Protocol):
    """Holds resources that a run needs."""

    def terminate(self) -> None:
        """End the run, also after a failure, and free what it needed; may be repeated."""


def input_order(slave: Slave) -> int:
    """Highest input derivative that the slave takes."""
    return slave.max_input_order if isinstance(slave, TakesInputDerivatives) else 0


def output_order(slave: Slave, outputs: Iterable[int] = ()) -> int:
    """Highest output derivative that the slave gives; of all of these outputs, by their indices."""
    highest = slave.max_output_order if isinstance(slave, GivesOutputDerivatives) else 0
    if isinstance(slave, LacksDerivatives):
        names = [slave.variables[index].name for index in outputs]
        return min([highest, *(slave.lacking[name] - 1 for name in names if name in slave.lacking)])
    return highest


def offset(slave: Slave) -> float:
    """First sample instant after the start [s]."""
    return slave.offset if isinstance(slave, HasOffset) else 0.0


def can_save(slave: Slave) -> bool:
    """Whether the slave can go back to an earlier state."""
    return isinstance(slave, SavesState) and (not isinstance(slave, MaySaveState) or slave.can_save)


def feedthrough(slave: Slave) -> dict[str, tuple[str, ...]]:
    """Name of each output → the inputs that it depends on at the same instant."""
    inputs = tuple(variable.name for variable in slave.variables if variable.causality == "input")
    declared = slave.feedthrough if isinstance(slave, DeclaresFeedthrough) else {}
    outputs = (variable.name for variable in slave.variables if variable.causality == "output")
    return {name: tuple(declared.get(name, inputs)) for name in outputs}


def check_sampling(sample_time: float, offset: float, where: str) -> None:
    """Check sample time and offset [s].

    Raises:
        InputError: the sample time isn't positive and finite, or the offset is negative or not finite.
    """
    if not (isfinite(sample_time) and sample_time > 0.0):
        raise InputError(f"{where}: the sample time must be positive, got {sample_time} s; 1e-3 s is 1 kHz")
    if not (isfinite(offset) and offset >= 0.0):
        raise InputError(f"{where}: the offset must be zero or positive, got {offset} s")

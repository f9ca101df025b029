"""Interface between master and slaves: a small protocol close to FMI's, and one small protocol per optional capability.

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
"""Type of an input → types of outputs that may be connected to it, as in SSP: no conversion loses information."""

COINCIDENT = 1e-6
"""Instants closer than this fraction of the communication step count as one, at the mark (a knot of a trajectory, say).

Rounding separates a mark and a communication point by about 1e-12 of a step after 1e5 steps. A step of less than a
millionth of the others would only cost time and precision."""


@dataclass(frozen=True)
class SlaveVariable:
    """A scalar variable that the master can connect, set or record.

    Attributes:
        name: name within the slave, for example ``joint1.torque``.
        causality: input, output or parameter.
        unit: unit, for example ``N.m``; empty if unknown, which is compatible with every unit.
        start: start value in ``unit``; None if the slave calculates it.
        discrete: whether it is piecewise constant, like counters and switches.
        type: type of the values; a String is passed as its code in `TEXTS`.

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
    """Numbers (codes) for texts, so that signals of type String are transferred like all others.

    A code keeps its text until the process ends, in its child processes too.
    """

    def __init__(self) -> None:
        self._codes: dict[str, int] = {}

    def code(self, text: str) -> float:
        """Return the code of a text; a new text gets the next code."""
        return float(self._codes.setdefault(text, len(self._codes)))

    def known(self) -> list[str]:
        """Return all texts, in the order of their codes."""
        return [*self._codes]

    def learn(self, texts: Iterable[str]) -> None:
        """Add the texts of a child process, in the order of their codes."""
        for text in texts:
            self.code(text)


TEXTS = Texts()
"""The texts of this process."""


class Slave(Protocol):
    """A model that can be initialised, set, stepped and read.

    A slave may state more about itself by these attributes:

    - ``feedthrough``: output → inputs that it depends on at the same instant; an output left out depends on all. Without the
      attribute every output depends on all inputs.
    - ``rates_follow_inputs``: True if outputs stay continuous when inputs jump, while their derivatives jump. At an exchange the
      master updates it after its inputs, unless that order alone would close a loop.
    - ``largest_step``: largest communication step [s], over which polynomials approximate its signals well; the master divides
      longer ones.
    - ``needs_regular_steps``: True if all communication steps must have the same length, as for an FMU that can't handle a
      variable communication step size.
    - ``period``: beside ``breakpoints``, the period [s] of outputs that repeat, 0 for others: what the master calculates for the points of one period can be
      used for the next ones.
    - ``latency``: output → its delay at low frequency [s], without the hold between samples, for the list of delays; undelayed
      outputs are left out.
    - ``lacking``: output → lowest order of its derivatives that isn't available, see `GivesOutputDerivatives`; outputs with all
      orders are left out.
    - ``can_save``: False if it has the methods of `SavesState`, but can't: an FMU that doesn't state canGetAndSetFMUstate.
    - ``offset``: for a `Sampled` slave the time from the start to its first sample instant [s], zero or positive; until then its
      outputs keep their initial values.
    - ``instants``: for a `Sampled` slave further sample instants, times from the start [s], ascending; with an infinite sample
      time it samples at these alone.
    """

    @property
    def name(self) -> str:
        """Name within the system, without a dot."""

    @property
    def variables(self) -> Sequence[SlaveVariable]:
        """All variables; `set` and `get` address a variable by its index here."""

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Initialise a run from ``start_time`` to ``stop_time`` [s]; inputs may be set beforehand."""

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs (n,) at the current time."""

    def get(self, indices: Indices, values: RealArray) -> None:
        """Write the variables' current values into ``values`` (n,)."""

    def step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s]; raise `SlaveError` (or any exception) on failure."""


@runtime_checkable
class TakesInputDerivatives(Protocol):
    """Takes input derivatives: within a step an input is the polynomial u(t + tau) = sum of u_k tau^k / k!."""

    @property
    def max_input_order(self) -> int:
        """Highest order of input derivatives that the slave uses; 0 for none."""

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Set time derivatives (orders, n) of inputs, row k - 1 for order k; their values have been set before."""


@runtime_checkable
class GivesOutputDerivatives(Protocol):
    """Provides time derivatives of its outputs at the current time."""

    @property
    def max_output_order(self) -> int:
        """Highest order of output derivatives that `get_derivatives` provides; 0 for none."""

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Write derivatives (orders, n) of outputs, row k - 1 for order k; at most ``max_output_order`` rows."""


@runtime_checkable
class HasBreakpoints(Protocol):
    """Has jumps at instants known before the run; the master makes each of them a communication point."""

    @property
    def breakpoints(self) -> Sequence[float]:
        """Instants [s], ascending, at which the outputs or their derivatives jump."""


@runtime_checkable
class PredictsOutputs(HasBreakpoints, Protocol):
    """Knows its outputs in advance, without inputs: announces them before a step as polynomials over that step.

    After `announce`, `get` and `get_derivatives` describe that polynomial at the beginning of the step (right limits);
    after `step` they return the left limits at its end.
    """

    @property
    def announced_order(self) -> int:
        """Degree of the announced polynomials."""

    @property
    def ends_exactly(self) -> bool:
        """Whether the announced polynomials reach the outputs' left limits at the end of the step."""

    def prepare(self, times: RealArray) -> None:
        """Store the coming communication points (N,) [s] and go to the left limits at the first of them.

        The master calls `prepare` before a run with its first points, and during the run at the last but one of these
        points with the next ones. With step control it does so before every step; the first point may then be earlier
        than the current time.
        """

    def announce(self, time: float) -> None:
        """Announce the step that begins at ``time``, one of the communication points."""


@runtime_checkable
class Sampled(Protocol):
    """Runs at its own instants start + offset + k * sample_time and holds its outputs in between; it is never stepped."""

    @property
    def sample_time(self) -> float:
        """Sample time [s]."""

    def sample(self, time: float) -> None:
        """Calculate new outputs from the inputs just set, and the state for the next sample instant."""


@runtime_checkable
class SamplesInTwoPhases(Sampled, Protocol):
    """Can calculate outputs before all inputs are known, such as a discrete system y = C x + D u with zeros in D.

    At a sample instant the master calls `output` once or more, then `update` once; `sample` does both.
    """

    def output(self, time: float) -> None:
        """Calculate outputs from the state and the inputs set so far; the state doesn't change."""

    def update(self, time: float) -> None:
        """Calculate the next state from the inputs just set; the outputs don't change."""


@runtime_checkable
class SavesState(Protocol):
    """Can save its state and restore it (rollback).

    With a method ``release(state)`` it frees a saved state that won't be restored again, or keeps its memory for the next one.
    """

    def save(self) -> object:
        """Return the complete state at the current time, inputs included."""

    def restore(self, state: object) -> None:
        """Restore a state returned by `save`; may be repeated."""


@runtime_checkable
class BindsBuffers(Protocol):
    """Binds calls that transfer values between fixed variables and fixed buffers, faster than `get` and `set`.

    Buffers are C-contiguous; shapes as in `Slave.set`, `Slave.get`, `TakesInputDerivatives.set_derivatives` and
    `GivesOutputDerivatives.get_derivatives`. Calls may be bound before the slave is initialised and are valid for all
    its runs; they may be made only between `Slave.initialize` and the end of a run. A slave that takes or gives
    derivatives binds them by ``bind_set_derivatives`` and ``bind_get_derivatives``.
    """

    def bind_set(self, indices: Indices, values: RealArray) -> Call: ...
    def bind_get(self, indices: Indices, values: RealArray) -> Call: ...


@runtime_checkable
class Reports(Protocol):
    """Reports on the last run: `report` returns the facts, `take_report` takes those of a run in another process.

    Attributes:
        remarks: findings for the user, one sentence each.
    """

    @property
    def remarks(self) -> Sequence[str]: ...
    def report(self) -> Mapping[str, Any]: ...
    def take_report(self, report: Mapping[str, Any]) -> None: ...


@runtime_checkable
class Terminates(Protocol):
    """Has resources that must be freed at the end of a run."""

    def terminate(self) -> None:
        """End the run, also after a failure, and free its resources; may be repeated."""


def input_order(slave: Slave) -> int:
    """Return the highest order of input derivatives that the slave takes; 0 for none."""
    return slave.max_input_order if isinstance(slave, TakesInputDerivatives) else 0


def output_order(slave: Slave, outputs: Iterable[int] = ()) -> int:
    """Return the highest order of derivatives that the slave provides for all outputs of these indices; 0 for none."""
    highest = slave.max_output_order if isinstance(slave, GivesOutputDerivatives) else 0
    lacking: Mapping[str, int] = getattr(slave, "lacking", {}) if highest else {}
    if lacking:
        names = [slave.variables[index].name for index in outputs]
        return min([highest, *(lacking[name] - 1 for name in names if name in lacking)])
    return highest


def offset(slave: Slave) -> float:
    """Return the time from the start to the first sample instant [s]."""
    return float(getattr(slave, "offset", 0.0))


def can_save(slave: Slave) -> bool:
    """Return whether the slave can save and restore its state."""
    return isinstance(slave, SavesState) and bool(getattr(slave, "can_save", True))


def feedthrough(slave: Slave) -> dict[str, tuple[str, ...]]:
    """Return the direct feedthrough: output → inputs that it depends on at the same instant."""
    inputs = tuple(variable.name for variable in slave.variables if variable.causality == "input")
    declared: Mapping[str, Sequence[str]] = getattr(slave, "feedthrough", {})
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

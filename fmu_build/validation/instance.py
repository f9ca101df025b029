"""Instances of an FMU under test: one base class with the same methods for co-simulation and model exchange.

The functions of the library record the current call, so that findings about hangs name it. Guards around memory that the FMU fills
detect writes beyond its bounds.
"""

from __future__ import annotations

import struct
import sys
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from ctypes import POINTER, byref, c_double, c_size_t, cast, create_string_buffer
from mmap import mmap
from time import monotonic, sleep
from typing import Any, ClassVar

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

RealArray = NDArray[np.float64]

GUARD = bytes(range(0xA0, 0xC0))
"""Bytes before and behind each block of memory that an FMU gets; a change reveals a write out of bounds."""

CANARY = -4.25e11
"""Value behind an array of doubles that the FMU fills; a change reveals a write out of bounds."""

_WARNING = 1
"""fmi2Warning."""

TRY = "flexfmu tries:"
"""Prefix of announcements on standard error, which name the current action if the FMU crashes."""


def announce(what: str) -> None:
    """Announce the next action on standard error."""
    with suppress(OSError):  # an FMU may have closed it
        print(f"{TRY}{what}", file=sys.stderr, flush=True)


class MisbehaviourError(RuntimeError):
    """An FMU violates the standard.

    Attributes:
        remedy: what to do.
    """

    def __init__(self, message: str, remedy: str) -> None:
        super().__init__(message)
        self.remedy = remedy


RECORD = 64
"""Size of the record of the current call [bytes]."""


class Watch:
    """Record of the FMI calls of this process, read by the watchdog thread.

    Attributes:
        call: name of the current call; empty if there is none.
        record: the same in shared memory, which outlives a crash.
        since: its start, by `time.monotonic` [s].
        calls: function → number of calls.
        warnings: function → number of calls that returned fmi2Warning.
    """

    call = ""
    record: ClassVar[bytearray | mmap] = bytearray(RECORD)
    since = 0.0
    calls: ClassVar[Counter[str]] = Counter()
    warnings: ClassVar[Counter[str]] = Counter()


class Watched:
    """Records each call in `Watch`."""

    def _call(self, name: str, *arguments: Any) -> Any:
        Watch.since = monotonic()
        Watch.call = name
        Watch.record[:] = name.encode()[:RECORD].ljust(RECORD)
        Watch.calls[name] += 1
        try:
            status = super()._call(name, *arguments)  # type: ignore[misc]
            Watch.warnings[name] += status == _WARNING
            return status
        finally:
            Watch.call = ""
            Watch.record[:] = bytes(RECORD)


class FMU2SlaveLibrary(Watched, fmi2.FMU2Slave):  # type: ignore[misc]
    """The functions for co-simulation; fmpy evaluates the prefix of the class name."""


class FMU2ModelLibrary(Watched, fmi2.FMU2Model):  # type: ignore[misc]
    """The functions for model exchange."""


def is_guarded(block: Any) -> bool:
    """Whether the guards of a block are unchanged."""
    content = bytes(memoryview(block))
    return content.startswith(GUARD) and content.endswith(GUARD)


LONGEST_PENDING = 5.0
"""Longest wall time of an asynchronous step [s]."""

_MOST_EVENT_ITERATIONS = 100
_WANDER = 1e-4
"""Change of the states between evaluations, relative to their size."""

_DISCARD, _PENDING = 2, 5
_ACCESS = {kind: kind for kind in ("Real", "Integer", "Boolean", "String")} | {"Enumeration": "Integer"}
"""Type of a variable → suffix of the functions that get and set it."""


class InstanceUnderTest(ABC):
    """Base class of instances; a failed FMI call raises fmpy's exception.

    Attributes:
        fmu: the `FmuUnderTest`: its description, default experiment, inputs and outputs.
        finished: whether the FMU has terminated the simulation.
        next_event: time of the FMU's next time event in model exchange [s]; infinite if there is none.
    """

    def __init__(self, fmu: Any, library: Any) -> None:
        self.fmu = fmu
        self.library = library
        self.finished = False
        self.next_event = np.inf

    @abstractmethod
    def initialize(self, values: Mapping[Any, Any] | None = None, late: bool = False) -> None:
        """Initialise with the default experiment, up to the first step; arguments as for `enter_initialization`."""

    @abstractmethod
    def advance(
        self, first: int, last: int, size: float = 1.0, between: Callable[[], object] = lambda: None
    ) -> RealArray:
        """Run the steps from ``first`` to ``last`` (excluded) with excited inputs; return the results, one row per step.

        The run ends early if the FMU terminates the simulation. ``size`` multiplies the excitation; ``between`` is called
        in each step after the inputs are set.
        """

    def run(self) -> RealArray:
        """Initialise, run all steps and terminate; return the results, one row per step."""
        self.initialize()
        rows = self.advance(0, self.fmu.steps)
        self.library.terminate()
        return rows

    def enter_initialization(self, values: Mapping[Any, Any] | None = None, late: bool = False) -> None:
        """Enter Initialization Mode with the default experiment; ``values`` (by variable) are set before, or ``late``: then."""
        fmu, values = self.fmu, values or {}
        self.finished = False
        if not late:
            self.write(list(values), list(values.values()))
        self.library.setupExperiment(tolerance=fmu.tolerance, startTime=fmu.start, stopTime=fmu.stop)
        self.library.enterInitializationMode()
        if late:
            self.write(list(values), list(values.values()))

    def get(self, variables: Sequence[Any]) -> RealArray:
        """Values of numeric and Boolean variables, shape (variables,)."""
        if all(variable.type == "Real" for variable in variables):
            references = [variable.valueReference for variable in variables]
            return np.array(self.library.getReal(references) if references else [], dtype=np.float64)
        return np.array(self.read(variables), dtype=np.float64)

    def set(self, variables: Sequence[Any], values: RealArray) -> None:
        """Set Real variables; ``values`` has shape (variables,)."""
        if variables:
            self.library.setReal([variable.valueReference for variable in variables], list(values))

    def read(self, variables: Sequence[Any]) -> list[Any]:
        """Values of variables of any type."""
        values: list[Any] = [None] * len(variables)
        for kind in {variable.type for variable in variables}:
            where = [n for n, variable in enumerate(variables) if variable.type == kind]
            getter = getattr(self.library, f"get{_ACCESS[kind]}")
            for n, value in zip(where, getter([variables[n].valueReference for n in where]), strict=True):
                values[n] = value.decode(errors="replace") if isinstance(value, bytes) else value
        return values

    def write(self, variables: Sequence[Any], values: Sequence[Any]) -> None:
        """Set variables of any type."""
        for variable, value in zip(variables, values, strict=True):
            getattr(self.library, f"set{_ACCESS[variable.type]}")([variable.valueReference], [value])

    def directional(self, unknowns: Sequence[Any], knowns: Sequence[Any], seed: RealArray) -> RealArray:
        """Directional derivatives of the unknowns along ``seed``, shape (unknowns,), from the FMU."""
        references = [[v.valueReference for v in variables] for variables in (unknowns, knowns)]
        return np.array(self.library.getDirectionalDerivative(*references, list(seed)), dtype=np.float64)

    def write_together(self, variables: Sequence[Any], values: Sequence[Any]) -> None:
        """Set variables of one type in one call."""
        setter = getattr(self.library, f"set{_ACCESS[variables[0].type]}")
        setter([variable.valueReference for variable in variables], list(values))

    def save(self, state: Any = None) -> Any:
        """Save the FMU state, into the memory of the earlier ``state`` if there is one; free it with `discard`."""
        if state is None:
            return self.library.getFMUstate(), self.next_event
        self.library.fmi2GetFMUstate(self.library.component, byref(state[0]))
        return state[0], self.next_event

    def restore(self, state: Any) -> None:
        """Continue from a saved state."""
        self.library.setFMUstate(state[0])
        self.next_event = state[1]
        self.finished = False

    def discard(self, state: Any) -> None:
        """Free a saved state; the FMU should set its pointer to NULL."""
        self.library.freeFMUstate(state[0])

    def serialize(self) -> bytes:
        """The serialised FMU state, preceded by the time of the next event.

        Raises:
            MisbehaviourError: the FMU writes more bytes than fmi2SerializedFMUstateSize returns.
        """
        state, size = self.save(), c_size_t()
        self.library.fmi2SerializedFMUstateSize(self.library.component, state[0], byref(size))
        # a guard behind the buffer detects a write beyond the size
        buffer = create_string_buffer(bytes(size.value) + GUARD, size.value + len(GUARD))
        self.library.fmi2SerializeFMUstate(self.library.component, state[0], buffer, size.value)
        self.discard(state)
        if buffer.raw[size.value :] != GUARD:
            raise MisbehaviourError(
                f"fmi2SerializeFMUstate writes beyond its buffer of {size.value} bytes",
                "write as many as fmi2SerializedFMUstateSize returns",
            )
        # only the importing tool knows the next event
        return struct.pack("d", self.next_event) + buffer.raw[: size.value]

    def restore_serialized(self, data: bytes) -> None:
        """Continue from a serialised state, possibly of another instance."""
        state = self.library.deSerializeFMUstate(data[8:]), *struct.unpack("d", data[:8])
        self.restore(state)
        self.discard(state)


class CosimulationInstance(InstanceUnderTest):
    """Instance for co-simulation: makes communication steps; the results are the outputs."""

    def initialize(self, values: Mapping[Any, Any] | None = None, late: bool = False) -> None:
        self.enter_initialization(values, late)
        self.library.exitInitializationMode()

    def advance(
        self, first: int, last: int, size: float = 1.0, between: Callable[[], object] = lambda: None
    ) -> RealArray:
        fmu = self.fmu
        rows = []
        for n in range(first, last):
            self.set(fmu.inputs, fmu.input_values(n, size))
            between()
            if not self.step(n, 1):
                break
            rows.append(self.get(fmu.outputs))
        return _table(rows, len(fmu.outputs))

    def step(self, n: float, parts: int = 1) -> bool:
        """Make a step of length ``step / parts`` from ``start + n * step``; False if the FMU terminates the simulation.

        Raises:
            MisbehaviourError: the FMU discards the step without terminating the simulation.
        """
        return self.step_from(self.fmu.start + n * self.fmu.step, self.fmu.step / parts)

    def read_steps(self, variables: Sequence[Any], count: int, parts: int) -> RealArray:
        """Values of variables after each of ``count`` communication steps from the start, shape (steps, variables).

        Every step is made in ``parts`` equal ones. There are fewer rows if the FMU terminates the simulation.
        """
        rows: list[RealArray] = []
        for n in range(count):
            if not all(self.step(n + part / parts, parts) for part in range(parts)):
                break
            rows.append(self.get(variables))
        return _table(rows, len(variables))

    def step_from(self, time: float, length: float) -> bool:
        """Make a step of any length [s] from any time [s]; returns and raises as `step`."""
        try:
            self.library.doStep(time, length)
        except FMICallException as error:
            # an asynchronous step, the end of the simulation, or an error
            if error.status == _PENDING:
                self._await()
            elif error.status != _DISCARD:
                raise
            elif self._has_terminated():
                self.finished = True
                return False
            else:
                raise MisbehaviourError(
                    f"fmi2DoStep discards the step of {length:g} s at {time:g} s",
                    "make the step, or end the simulation (fmi2Terminated)",
                ) from None
        return True

    def _has_terminated(self) -> bool:
        """Whether the FMU discarded the step because it terminates the simulation (fmi2Terminated)."""
        with suppress(FMICallException):
            return bool(self.library.getBooleanStatus(fmi2.fmi2Terminated))
        return False

    def _await(self) -> None:
        """Wait for the end of an asynchronous step."""
        if not self.fmu.element.canRunAsynchronuously:
            raise MisbehaviourError(
                "fmi2DoStep returns fmi2Pending, canRunAsynchronuously is not claimed",
                "claim it, or finish the step before returning",
            )
        begin = monotonic()
        while (status := self.library.getStatus(fmi2.fmi2DoStepStatus)) == _PENDING:
            if monotonic() - begin > LONGEST_PENDING:
                raise MisbehaviourError(f"fmi2DoStep is pending for {LONGEST_PENDING:g} s", "let the step end")
            try:
                self.library.getStringStatus(fmi2.fmi2PendingStatus)
            except FMICallException:  # it may have nothing to say
                pass
            except AttributeError:  # no text
                message = "fmi2GetStringStatus gives no text for fmi2PendingStatus"
                raise MisbehaviourError(message, "say what goes on, or return fmi2Discard") from None
            sleep(1e-3)
        if status > 1:
            raise MisbehaviourError(f"a pending fmi2DoStep ends with status {status}", "carry out the step")


class ExchangeInstance(InstanceUnderTest):
    """Instance for model exchange: perturbs the states without integrating; the results are state derivatives and outputs."""

    def initialize(self, values: Mapping[Any, Any] | None = None, late: bool = False) -> None:
        self.enter_initialization(values, late)
        self.library.exitInitializationMode()
        description = self.fmu.description
        self.states = int(description.numberOfContinuousStates or len(description.derivatives or ()))
        self.handle_events()

    def advance(
        self, first: int, last: int, size: float = 1.0, between: Callable[[], object] = lambda: None
    ) -> RealArray:
        fmu = self.fmu
        rows: list[RealArray] = []
        for n in range(first, last):
            if self.finished:
                break
            # new time, inputs and states
            time = fmu.start + n * fmu.step
            self.library.setTime(time)
            self.set(fmu.inputs, fmu.input_values(n, size))
            if self.states:
                x = self.continuous_states()
                self.set_continuous_states(x + _WANDER * np.maximum(np.abs(x), 1e-3) * np.sin(n + np.arange(x.size)))
            between()
            # evaluate
            rows.append(np.hstack([self.derivatives(), self.get(fmu.outputs)]))
            # complete the integrator step; handle a step event or time event
            event, self.finished = self.library.completedIntegratorStep()
            if not self.finished and (event or time >= self.next_event):
                self.library.enterEventMode()
                self.handle_events()
        return _table(rows, self.states + len(fmu.outputs))

    def continuous_states(self) -> RealArray:
        """The continuous states x, shape (states,)."""
        return self._vector(self.library.getContinuousStates)

    def set_continuous_states(self, x: RealArray) -> None:
        """Set the continuous states x, shape (states,)."""
        self.library.setContinuousStates(_pointer(np.ascontiguousarray(x)), self.states)

    def derivatives(self) -> RealArray:
        """State derivatives dx/dt, shape (states,)."""
        return self._vector(self.library.getDerivatives)

    def nominals(self) -> RealArray:
        """Nominal values of the states, shape (states,)."""
        return self._vector(self.library.getNominalsOfContinuousStates)

    def event_indicators(self) -> RealArray:
        """The event indicators, shape (numberOfEventIndicators,).

        Raises:
            MisbehaviourError: the FMU writes more values.
        """
        count = int(self.fmu.description.numberOfEventIndicators or 0)
        z = np.zeros(count + 1)
        z[-1] = CANARY
        self.library.getEventIndicators(_pointer(z), count)
        if z[-1] != CANARY:
            raise MisbehaviourError(f"fmi2GetEventIndicators writes more than {count} values", "fill ni values")
        return z[:count]

    def _vector(self, getter: Any) -> RealArray:
        x = np.zeros(self.states)
        if self.states:
            getter(_pointer(x), self.states)
        return x

    def handle_events(self) -> None:
        """Iterate events in Event Mode, then enter Continuous-Time Mode unless the FMU terminates the simulation.

        Raises:
            MisbehaviourError: the event iteration does not converge.
        """
        self.finished, self.next_event = settled(self.library)
        if not self.finished:
            self.library.enterContinuousTimeMode()


def settled(library: Any) -> tuple[bool, float]:
    """Iterate events in Event Mode; return whether the FMU terminates the simulation, and its next time event [s] or infinity.

    Raises:
        MisbehaviourError: the event iteration does not converge.
    """
    for _ in range(_MOST_EVENT_ITERATIONS):
        needed, finished, _, _, defined, time = library.newDiscreteStates()
        if finished or not needed:
            return bool(finished), time if defined else np.inf
    raise MisbehaviourError(
        f"fmi2NewDiscreteStates wants more than {_MOST_EVENT_ITERATIONS} iterations",
        "let newDiscreteStatesNeeded become fmi2False",
    )


def _table(rows: list[RealArray], width: int) -> RealArray:
    return np.array(rows, dtype=np.float64).reshape(len(rows), width)


def _pointer(values: RealArray) -> Any:
    return cast(values.ctypes.data, POINTER(c_double))

"""One instance of an FMU under test, for co-simulation or for model exchange, with the same calls for both."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from ctypes import POINTER, byref, c_double, c_size_t, cast, create_string_buffer
from time import sleep
from typing import Any, Protocol

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from flexfmu.fmu_build.validation.library import CANARY, GUARD, MisbehaviourError

RealArray = NDArray[np.float64]

_MOST_EVENT_ITERATIONS = 100
_WANDER = 1e-4
"""How far states are moved, relative to their size, to have something to evaluate."""

_DISCARD, _PENDING = 2, 5
_ACCESS = {
    "Real": "Real",
    "Integer": "Integer",
    "Enumeration": "Integer",
    "Boolean": "Boolean",
    "String": "String",
}
"""Type of a variable → ending of the functions that get and set it."""


class Subject(Protocol):
    """What an instance has to know of its FMU.

    Attributes:
        description: model description as fmpy reads it.
        start, stop, step: of the default experiment [s].
        tolerance: of the default experiment; None where it has none.
        inputs, outputs: variables that are set and read in each step.
    """

    description: Any
    start: float
    stop: float
    step: float
    tolerance: float | None
    inputs: list[Any]
    outputs: list[Any]

    @property
    def element(self) -> Any:
        """The description's element of this interface."""

    @property
    def steps(self) -> int:
        """Communication steps of a run."""

    def input_values(self, n: int, size: float = 1.0) -> RealArray:
        """Inputs at step ``n``, with changes multiplied by ``size``."""


class InstanceUnderTest(ABC):
    """An instance; a failed FMI call raises fmpy's exception.

    Attributes:
        finished: whether the FMU has ended the simulation by itself.
        next_event: time of the next event that the FMU has asked for, in model exchange [s].
    """

    def __init__(self, fmu: Subject, library: Any) -> None:
        self.fmu = fmu
        self.library = library
        self.finished = False
        self.next_event = np.inf

    @abstractmethod
    def initialize(self, values: Mapping[Any, Any] | None = None) -> None:
        """Everything up to the first step, with the default experiment; ``values`` are set first of all, by variable."""

    @abstractmethod
    def advance(
        self, first: int, last: int, size: float = 1.0, between: Callable[[], object] | None = None
    ) -> RealArray:
        """Go through the steps ``first`` to ``last`` with small changes of the inputs; the results, one row a step.

        It ends earlier where the FMU ends the simulation. ``size`` multiplies the changes; ``between`` is called in each step
        after the inputs are set.
        """

    def run(self) -> RealArray:
        """Some steps of the default experiment; the results, one row a step."""
        self.initialize()
        rows = self.advance(0, self.fmu.steps)
        self.library.terminate()
        return rows

    def enter_initialization(self, values: Mapping[Any, Any] | None = None) -> None:
        """Up to Initialization Mode; ``values`` are set before."""
        fmu = self.fmu
        self.finished = False
        for variable, value in (values or {}).items():
            self.write([variable], [value])
        self.library.setupExperiment(tolerance=fmu.tolerance, startTime=fmu.start, stopTime=fmu.stop)
        self.library.enterInitializationMode()

    def version(self) -> tuple[str, str]:
        """FMI version and types platform that the binary returns."""
        return self.library.getVersion(), self.library.getTypesPlatform()

    def get(self, variables: Sequence[Any]) -> RealArray:
        """Values of numbers and Booleans, shape (variables,)."""
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
                values[n] = (value or b"").decode(errors="replace") if kind == "String" else value
        return values

    def write(self, variables: Sequence[Any], values: Sequence[Any]) -> None:
        """Set variables of any type."""
        for variable, value in zip(variables, values, strict=True):
            getattr(self.library, f"set{_ACCESS[variable.type]}")([variable.valueReference], [value])

    def directional(self, unknowns: Sequence[Any], knowns: Sequence[Any], seed: RealArray) -> RealArray:
        """What the FMU says of the unknowns' derivatives along ``seed``, shape (unknowns,)."""
        references = [[v.valueReference for v in variables] for variables in (unknowns, knowns)]
        return np.array(self.library.getDirectionalDerivative(*references, list(seed)), dtype=np.float64)

    def reset(self) -> None:
        """Back to the state after instantiation."""
        self.library.reset()

    def write_together(self, variables: Sequence[Any], values: Sequence[Any]) -> None:
        """Set variables of one type in one call."""
        setter = getattr(self.library, f"set{_ACCESS[variables[0].type]}")
        setter([variable.valueReference for variable in variables], list(values))

    def save(self, state: Any = None) -> Any:
        """The complete state, in the memory of another one that was saved before if there is one; give it back with `discard`."""
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
        """Free a saved state; its pointer is null then."""
        self.library.freeFMUstate(state[0])

    def serialize(self) -> bytes:
        """The complete state as bytes, what the importing tool has to know of it first.

        Raises:
            MisbehaviourError: the FMU writes beyond the size that it has returned.
        """
        state, size = self.save(), c_size_t()
        self.library.fmi2SerializedFMUstateSize(self.library.component, state[0], byref(size))
        # a guard behind the buffer shows whether the FMU keeps to the size
        buffer = create_string_buffer(bytes(size.value) + GUARD, size.value + len(GUARD))
        self.library.fmi2SerializeFMUstate(self.library.component, state[0], buffer, size.value)
        self.discard(state)
        if buffer.raw[size.value :] != GUARD:
            raise MisbehaviourError(
                f"fmi2SerializeFMUstate writes beyond its buffer of {size.value} bytes",
                "write as many as fmi2SerializedFMUstateSize returns",
            )
        # the next event is known to the importing tool alone
        return struct.pack("d", self.next_event) + buffer.raw[: size.value]

    def restore_serialized(self, data: bytes) -> None:
        """Continue from the bytes of another instance's state."""
        state = self.library.deSerializeFMUstate(data[8:]), *struct.unpack("d", data[:8])
        self.restore(state)
        self.discard(state)


class CosimulationInstance(InstanceUnderTest):
    """Makes communication steps; the results are the outputs."""

    def initialize(self, values: Mapping[Any, Any] | None = None) -> None:
        self.enter_initialization(values)
        self.library.exitInitializationMode()

    def advance(
        self, first: int, last: int, size: float = 1.0, between: Callable[[], object] | None = None
    ) -> RealArray:
        fmu = self.fmu
        rows = []
        for n in range(first, last):
            self.set(fmu.inputs, fmu.input_values(n, size))
            if between is not None:
                between()
            if not self.step(n, 1):
                break
            rows.append(self.get(fmu.outputs))
        return _table(rows, len(fmu.outputs))

    def step(self, n: float, parts: int = 1) -> bool:
        """A step from ``start + n * step`` of length ``step / parts``; whether it was made: the FMU may end the simulation.

        Raises:
            MisbehaviourError: the FMU discards the step without ending the simulation.
        """
        return self.step_from(self.fmu.start + n * self.fmu.step, self.fmu.step / parts)

    def step_from(self, time: float, length: float) -> bool:
        """The same for a step of any length [s], from any time [s]."""
        try:
            self.library.doStep(time, length)
        except FMICallException as error:
            # the step goes on, the simulation ends, or it is an error
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
        """Whether a discarded step is the end of the simulation (fmi2Terminated)."""
        with suppress(FMICallException):
            return bool(self.library.getBooleanStatus(fmi2.fmi2Terminated))
        return False

    def _await(self) -> None:
        """Wait for the end of a step that the FMU computes asynchronously."""
        if not self.fmu.element.canRunAsynchronuously:
            raise MisbehaviourError(
                "fmi2DoStep returns fmi2Pending, canRunAsynchronuously is not claimed",
                "claim it, or finish the step before returning",
            )
        while (status := self.library.getStatus(fmi2.fmi2DoStepStatus)) == _PENDING:
            sleep(1e-3)
        if status > 1:
            raise MisbehaviourError(f"a pending fmi2DoStep ends with status {status}", "carry out the step")


class ExchangeInstance(InstanceUnderTest):
    """Moves the states back and forth without integrating; the results are the states' derivatives and outputs."""

    def initialize(self, values: Mapping[Any, Any] | None = None) -> None:
        self.enter_initialization(values)
        self.library.exitInitializationMode()
        self.states = len(self.fmu.description.derivatives or ())
        self.handle_events()

    def advance(
        self, first: int, last: int, size: float = 1.0, between: Callable[[], object] | None = None
    ) -> RealArray:
        fmu = self.fmu
        rows: list[RealArray] = []
        for n in range(first, last):
            if self.finished:
                break
            # another time, other inputs, other states
            time = fmu.start + n * fmu.step
            self.library.setTime(time)
            self.set(fmu.inputs, fmu.input_values(n, size))
            if self.states:
                x = self.continuous_states()
                self.set_continuous_states(x + _WANDER * np.maximum(np.abs(x), 1e-3) * np.sin(n + np.arange(x.size)))
            if between is not None:
                between()
            # what is evaluated there
            rows.append(np.hstack([self.derivatives(), self.get(fmu.outputs)]))
            # the end of the integrator's step, with an event where the FMU asks for one
            event, self.finished = self.library.completedIntegratorStep()
            if not self.finished and (event or time >= self.next_event):
                self.library.enterEventMode()
                self.handle_events()
        return _table(rows, self.states + len(fmu.outputs))

    def continuous_states(self) -> RealArray:
        """The states x, shape (states,)."""
        return self._vector(self.library.getContinuousStates)

    def set_continuous_states(self, x: RealArray) -> None:
        """Set the states x, shape (states,)."""
        self.library.setContinuousStates(_pointer(np.ascontiguousarray(x)), self.states)

    def derivatives(self) -> RealArray:
        """Derivatives of the states, shape (states,)."""
        return self._vector(self.library.getDerivatives)

    def nominals(self) -> RealArray:
        """Orders of magnitude of the states, shape (states,)."""
        return self._vector(self.library.getNominalsOfContinuousStates)

    def event_indicators(self) -> RealArray:
        """The event indicators, as many as the description has.

        Raises:
            MisbehaviourError: the FMU writes more of them.
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
        """From Event Mode to Continuous-Time Mode, or to the end."""
        for _ in range(_MOST_EVENT_ITERATIONS):
            needed, self.finished, _, _, defined, time = self.library.newDiscreteStates()
            if self.finished:
                return
            if not needed:
                self.next_event = time if defined else np.inf
                self.library.enterContinuousTimeMode()
                return
        raise MisbehaviourError(
            f"fmi2NewDiscreteStates wants more than {_MOST_EVENT_ITERATIONS} iterations",
            "let newDiscreteStatesNeeded become fmi2False",
        )


def _table(rows: list[RealArray], width: int) -> RealArray:
    return np.array(rows, dtype=np.float64).reshape(len(rows), width)


def _pointer(values: RealArray) -> Any:
    return cast(values.ctypes.data, POINTER(c_double))

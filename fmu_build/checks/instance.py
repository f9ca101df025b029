"""One instance of an FMU under test, for co-simulation or for model exchange, with the same calls for both."""

from __future__ import annotations

import struct
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from ctypes import POINTER, c_double, cast
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

import numpy as np
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

if TYPE_CHECKING:
    from flexfmu.fmu_build.checks.fmu import FmuUnderTest

Vector = NDArray[np.float64]

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


TRY = "flexfmu tries:"
"""Beginning of a line on standard error that says what is tried, should the FMU crash."""


def announce(what: str) -> None:
    """Say what is tried next."""
    print(f"{TRY}{what}", file=sys.stderr, flush=True)


class Watch:
    """Which FMI call is under way, and since when; another thread may look."""

    call = ""
    since = 0.0


class _Watched:
    """Tells `Watch` of each call."""

    def _call(self, name: str, *arguments: Any) -> Any:
        Watch.since = monotonic()
        Watch.call = name
        try:
            return super()._call(name, *arguments)  # type: ignore[misc]
        finally:
            Watch.call = ""


class FMU2SlaveLibrary(_Watched, fmi2.FMU2Slave):  # type: ignore[misc]
    """The functions for co-simulation; fmpy looks at the beginning of the class's name."""


class FMU2ModelLibrary(_Watched, fmi2.FMU2Model):  # type: ignore[misc]
    """The functions for model exchange."""


class Instance(ABC):
    """An instance; a failed FMI call raises fmpy's exception.

    Attributes:
        finished: whether the FMU has ended the simulation by itself.
        next_event: time of the next event that the FMU has asked for, in model exchange [s].
    """

    def __init__(self, fmu: FmuUnderTest, library: Any) -> None:
        self.fmu = fmu
        self.library = library
        self.finished = False
        self.next_event = np.inf

    @abstractmethod
    def initialize(self, values: Mapping[Any, Any] | None = None) -> None:
        """Everything up to the first step, with the default experiment; ``values`` are set first of all, by variable."""

    @abstractmethod
    def advance(self, first: int, last: int, size: float = 1.0, between: Callable[[], object] | None = None) -> Vector:
        """Go through the steps ``first`` to ``last`` with small changes of the inputs; what comes out, one row a step.

        It ends earlier where the FMU ends the simulation. ``size`` multiplies the changes; ``between`` is called in each step
        after the inputs are set.
        """

    def run(self) -> Vector:
        """Some steps of the default experiment; what comes out, one row a step."""
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
        """FMI version and types platform that the binary tells."""
        return self.library.getVersion(), self.library.getTypesPlatform()

    def get(self, variables: Sequence[Any]) -> Vector:
        """Values of numbers and Booleans, shape (variables,)."""
        if all(variable.type == "Real" for variable in variables):
            references = [variable.valueReference for variable in variables]
            return np.array(self.library.getReal(references) if references else [], dtype=np.float64)
        return np.array(self.read(variables), dtype=np.float64)

    def set(self, variables: Sequence[Any], values: Vector) -> None:
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

    def directional(self, unknowns: Sequence[Any], knowns: Sequence[Any], seed: Vector) -> Vector:
        """What the FMU says of the unknowns' derivatives along ``seed``, shape (unknowns,)."""
        references = [[v.valueReference for v in variables] for variables in (unknowns, knowns)]
        return np.array(self.library.getDirectionalDerivative(*references, list(seed)), dtype=np.float64)

    def reset(self) -> None:
        """Back to the state after instantiation."""
        self.library.reset()

    def save(self) -> Any:
        """The complete state; give it back with `discard`."""
        return self.library.getFMUstate(), self.next_event

    def restore(self, state: Any) -> None:
        """Continue from a saved state."""
        self.library.setFMUstate(state[0])
        self.next_event = state[1]
        self.finished = False

    def discard(self, state: Any) -> None:
        """Free a saved state."""
        self.library.freeFMUstate(state[0])

    def serialize(self) -> bytes:
        """The complete state as bytes, what the importing tool has to know of it first."""
        state = self.save()
        data: bytes = self.library.serializeFMUstate(state[0])
        self.discard(state)
        return struct.pack("d", self.next_event) + data

    def restore_serialized(self, data: bytes) -> None:
        """Continue from the bytes of another instance's state."""
        state = self.library.deSerializeFMUstate(data[8:]), *struct.unpack("d", data[:8])
        self.restore(state)
        self.discard(state)


class CosimulationInstance(Instance):
    """Makes communication steps; what comes out are the outputs."""

    def initialize(self, values: Mapping[Any, Any] | None = None) -> None:
        self.enter_initialization(values)
        self.library.exitInitializationMode()

    def advance(self, first: int, last: int, size: float = 1.0, between: Callable[[], object] | None = None) -> Vector:
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
            RuntimeError: the FMU discards the step without ending the simulation.
        """
        fmu = self.fmu
        time, length = fmu.start + n * fmu.step, fmu.step / parts
        try:
            self.library.doStep(time, length)
        except FMICallException as error:
            if error.status == _PENDING:
                self._await()
            elif error.status != _DISCARD:
                raise
            elif self._has_terminated():
                self.finished = True
                return False
            else:
                raise RuntimeError(f"fmi2DoStep discards the step of {length:g} s at {time:g} s") from None
        return True

    def _has_terminated(self) -> bool:
        """Whether a discarded step is the end of the simulation (fmi2Terminated)."""
        with suppress(FMICallException):
            return bool(self.library.getBooleanStatus(fmi2.fmi2Terminated))
        return False

    def _await(self) -> None:
        """Wait for the end of a step that goes on elsewhere."""
        if not self.fmu.element.canRunAsynchronuously:
            raise RuntimeError("fmi2DoStep returns fmi2Pending, canRunAsynchronuously is not claimed")
        while (status := self.library.getStatus(fmi2.fmi2DoStepStatus)) == _PENDING:
            sleep(1e-3)
        if status > 1:
            raise RuntimeError(f"a pending fmi2DoStep ends with status {status}")


class ExchangeInstance(Instance):
    """Moves the states to and fro without integrating; what comes out are states' derivatives and outputs."""

    def initialize(self, values: Mapping[Any, Any] | None = None) -> None:
        self.enter_initialization(values)
        self.library.exitInitializationMode()
        self.states = len(self.fmu.description.derivatives or ())
        self._handle_events()

    def advance(self, first: int, last: int, size: float = 1.0, between: Callable[[], object] | None = None) -> Vector:
        fmu = self.fmu
        rows: list[Vector] = []
        for n in range(first, last):
            if self.finished:
                break
            time = fmu.start + n * fmu.step
            self.library.setTime(time)
            self.set(fmu.inputs, fmu.input_values(n, size))
            if self.states:
                x = self.continuous_states()
                self.set_continuous_states(x + _WANDER * np.maximum(np.abs(x), 1e-3) * np.sin(n + np.arange(x.size)))
            if between is not None:
                between()
            rows.append(np.hstack([self.derivatives(), self.get(fmu.outputs)]))
            event, self.finished = self.library.completedIntegratorStep()
            if not self.finished and (event or time >= self.next_event):
                self.library.enterEventMode()
                self._handle_events()
        return _table(rows, self.states + len(fmu.outputs))

    def continuous_states(self) -> Vector:
        """The states x, shape (states,)."""
        return self._vector(self.library.getContinuousStates)

    def set_continuous_states(self, x: Vector) -> None:
        """Set the states x, shape (states,)."""
        self.library.setContinuousStates(_pointer(np.ascontiguousarray(x)), self.states)

    def derivatives(self) -> Vector:
        """Derivatives of the states, shape (states,)."""
        return self._vector(self.library.getDerivatives)

    def nominals(self) -> Vector:
        """Orders of magnitude of the states, shape (states,)."""
        return self._vector(self.library.getNominalsOfContinuousStates)

    def _vector(self, getter: Any) -> Vector:
        x = np.zeros(self.states)
        if self.states:
            getter(_pointer(x), self.states)
        return x

    def _handle_events(self) -> None:
        """From Event Mode to Continuous-Time Mode, or to the end."""
        for _ in range(_MOST_EVENT_ITERATIONS):
            needed, self.finished, _, _, defined, time = self.library.newDiscreteStates()
            if self.finished:
                return
            if not needed:
                self.next_event = time if defined else np.inf
                self.library.enterContinuousTimeMode()
                return
        raise RuntimeError(f"fmi2NewDiscreteStates wants more than {_MOST_EVENT_ITERATIONS} iterations")


def _table(rows: list[Vector], width: int) -> Vector:
    return np.array(rows, dtype=np.float64).reshape(len(rows), width)


def _pointer(values: Vector) -> Any:
    return cast(values.ctypes.data, POINTER(c_double))

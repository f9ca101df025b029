"""One instance of an FMU under test, for co-simulation or for model exchange, with the same calls for both."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from ctypes import POINTER, c_double, cast
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from flexfmu.fmu_build.checks.fmu import FmuUnderTest

Vector = NDArray[np.float64]

_MOST_EVENT_ITERATIONS = 100
_WANDER = 1e-4
"""How far states are moved, relative to their size, to have something to evaluate."""


class Instance(ABC):
    """An instance; a failed FMI call raises fmpy's exception."""

    def __init__(self, fmu: FmuUnderTest, library: Any) -> None:
        self.fmu = fmu
        self.library = library

    @abstractmethod
    def initialize(self) -> None:
        """Everything up to the first step, with the default experiment."""

    @abstractmethod
    def advance(self, first: int, last: int) -> Vector:
        """Go through the steps ``first`` to ``last`` with small changes of the inputs; what comes out, one row a step."""

    def run(self) -> Vector:
        """The whole default experiment; what comes out, one row a step."""
        self.initialize()
        rows = self.advance(0, self.fmu.steps)
        self.library.terminate()
        return rows

    def enter_initialization(self) -> None:
        """Up to Initialization Mode."""
        fmu = self.fmu
        self.library.setupExperiment(tolerance=fmu.tolerance, startTime=fmu.start, stopTime=fmu.stop)
        self.library.enterInitializationMode()

    def version(self) -> tuple[str, str]:
        """FMI version and types platform that the binary tells."""
        return self.library.getVersion(), self.library.getTypesPlatform()

    def get(self, variables: Sequence[Any]) -> Vector:
        """Values of Real variables, shape (variables,)."""
        references = [variable.valueReference for variable in variables]
        return np.array(self.library.getReal(references) if references else [], dtype=np.float64)

    def set(self, variables: Sequence[Any], values: Vector) -> None:
        """Set Real variables; ``values`` has shape (variables,)."""
        if variables:
            self.library.setReal([variable.valueReference for variable in variables], list(values))

    def directional(self, unknowns: Sequence[Any], knowns: Sequence[Any], seed: Vector) -> Vector:
        """What the FMU says of the unknowns' derivatives along ``seed``, shape (unknowns,)."""
        references = [[v.valueReference for v in variables] for variables in (unknowns, knowns)]
        return np.array(self.library.getDirectionalDerivative(*references, list(seed)), dtype=np.float64)

    def reset(self) -> None:
        """Back to the state after instantiation."""
        self.library.reset()

    def save(self) -> Any:
        """The complete state; give it back with `discard`."""
        return self.library.getFMUstate()

    def restore(self, state: Any) -> None:
        """Continue from a saved state."""
        self.library.setFMUstate(state)

    def discard(self, state: Any) -> None:
        """Free a saved state."""
        self.library.freeFMUstate(state)

    def serialize(self) -> bytes:
        """The complete state as bytes."""
        state = self.save()
        data: bytes = self.library.serializeFMUstate(state)
        self.discard(state)
        return data

    def restore_serialized(self, data: bytes) -> None:
        """Continue from the bytes of another instance's state."""
        state = self.library.deSerializeFMUstate(data)
        self.restore(state)
        self.discard(state)


class CosimulationInstance(Instance):
    """Makes communication steps; what comes out are the outputs."""

    def initialize(self) -> None:
        self.enter_initialization()
        self.library.exitInitializationMode()

    def advance(self, first: int, last: int) -> Vector:
        fmu = self.fmu
        rows = []
        for n in range(first, last):
            self.set(fmu.inputs, fmu.input_values(n))
            self.step(n, 1)
            rows.append(self.get(fmu.outputs))
        return np.array(rows, dtype=np.float64).reshape(last - first, -1)

    def step(self, n: float, parts: int = 1) -> None:
        """A step from ``start + n * step`` of length ``step / parts``."""
        fmu = self.fmu
        self.library.doStep(fmu.start + n * fmu.step, fmu.step / parts)


class ExchangeInstance(Instance):
    """Moves the states to and fro without integrating; what comes out are states' derivatives and outputs."""

    def initialize(self) -> None:
        self.enter_initialization()
        self.library.exitInitializationMode()
        self._iterate_events()
        self.library.enterContinuousTimeMode()
        self.states = len(self.fmu.description.derivatives or ())

    def advance(self, first: int, last: int) -> Vector:
        fmu = self.fmu
        rows = []
        for n in range(first, last):
            self.library.setTime(fmu.start + n * fmu.step)
            self.set(fmu.inputs, fmu.input_values(n))
            x = self.continuous_states()
            self.set_continuous_states(x + _WANDER * np.maximum(np.abs(x), 1e-3) * np.sin(n + np.arange(x.size)))
            rows.append(np.hstack([self.derivatives(), self.get(fmu.outputs)]))
            self.library.completedIntegratorStep()
        return np.array(rows, dtype=np.float64).reshape(last - first, -1)

    def continuous_states(self) -> Vector:
        """The states x, shape (states,)."""
        return self._vector(self.library.getContinuousStates)

    def set_continuous_states(self, x: Vector) -> None:
        """Set the states x, shape (states,)."""
        self.library.setContinuousStates(_pointer(np.ascontiguousarray(x)), self.states)

    def derivatives(self) -> Vector:
        """Derivatives of the states, shape (states,)."""
        return self._vector(self.library.getDerivatives)

    def _vector(self, getter: Any) -> Vector:
        x = np.zeros(self.states)
        getter(_pointer(x), self.states)
        return x

    def _iterate_events(self) -> None:
        for _ in range(_MOST_EVENT_ITERATIONS):
            needed, terminated, *_ = self.library.newDiscreteStates()
            if terminated:
                raise RuntimeError("fmi2NewDiscreteStates wants to end the simulation at the start")
            if not needed:
                return
        raise RuntimeError(f"fmi2NewDiscreteStates wants more than {_MOST_EVENT_ITERATIONS} iterations")


def _pointer(values: Vector) -> Any:
    return cast(values.ctypes.data, POINTER(c_double))

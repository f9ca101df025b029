"""An FMU under test: its default experiment, the variables to look at, and instances of it on request."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import byref
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2
from numpy.typing import NDArray

from flexfmu.fmu_build.checks.instance import CosimulationInstance, ExchangeInstance, Instance

_DEFAULT_STEPS = 500
"""Communication steps of an FMU that proposes no step size."""

EXCITATION = 1e-3
"""Amplitude of what is added to the inputs' start values, relative to their size: small enough for any model."""

_MOST_LOCALS = 100


class Kind(Enum):
    """The two interfaces of FMI 2.0."""

    COSIMULATION = "co-simulation"
    EXCHANGE = "model exchange"


@dataclass
class FmuUnderTest:
    """An extracted FMU with its default experiment; collects what its instances log and allocate.

    Attributes:
        description: model description as fmpy reads it.
        folder: the extracted FMU.
        kind: the interface under test.
        maximum_steps: communication steps that a run has at most.
        messages: log messages of all instances so far.
        blocks: blocks of memory that instances got through the callbacks and have not given back.
    """

    description: Any
    folder: Path
    kind: Kind
    maximum_steps: int
    messages: list[str] = field(default_factory=list)
    blocks: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        experiment = self.description.defaultExperiment
        self.start = _time(experiment, "startTime") or 0.0
        stop = _time(experiment, "stopTime") or self.start + 1.0
        self.step = _time(experiment, "stepSize") or (stop - self.start) / _DEFAULT_STEPS
        self.steps = max(1, min(round((stop - self.start) / self.step), self.maximum_steps))
        self.stop = max(stop, self.start + self.steps * self.step)
        self.tolerance = _time(experiment, "tolerance")
        self.outputs = self._recorded()
        self.inputs = self._variables("input", "continuous")

    @property
    def element(self) -> Any:
        """The description's element of this interface."""
        description = self.description
        return description.coSimulation if self.kind is Kind.COSIMULATION else description.modelExchange

    @property
    def can_save(self) -> bool:
        """Whether states can be saved and restored."""
        return bool(self.element.canGetAndSetFMUstate)

    @property
    def can_serialize(self) -> bool:
        """Whether saved states can be turned into bytes."""
        return self.can_save and bool(self.element.canSerializeFMUstate)

    @property
    def can_have_two(self) -> bool:
        """Whether several instances may live in one process."""
        return not self.element.canBeInstantiatedOnlyOncePerProcess

    @property
    def has_variable_step(self) -> bool:
        """Whether a communication step of any size may be made."""
        return self.kind is Kind.COSIMULATION and bool(self.element.canHandleVariableCommunicationStepSize)

    def input_values(self, n: int) -> NDArray[np.float64]:
        """Inputs at step ``n``: their starts, and a little more that changes from step to step; shape (inputs,)."""
        return np.array([_excited(variable, n + 7.0 * k) for k, variable in enumerate(self.inputs)])

    @property
    def smooth_outputs(self) -> list[Any]:
        """Recorded variables that change continuously: those that solvers can be judged by."""
        return [variable for variable in self.outputs if (variable.variability or "continuous") == "continuous"]

    @property
    def resource_uri(self) -> str:
        """Where the resources are, as a file URI."""
        return (self.folder / "resources").absolute().as_uri()

    @contextmanager
    def instance(self, name: str, guid: str | None = None, uri: str | None = None) -> Iterator[Any]:
        """An instance that is freed at the end; ``guid`` and ``uri`` replace the right ones.

        Raises:
            RuntimeError: fmi2Instantiate returns nothing.
            Exception: as fmpy does, if the library cannot be loaded.
        """
        is_slave = self.kind is Kind.COSIMULATION
        library = (fmi2.FMU2Slave if is_slave else fmi2.FMU2Model)(
            guid=guid or self.description.guid,
            modelIdentifier=self.element.modelIdentifier,
            unzipDirectory=str(self.folder),
            instanceName=name,
        )
        library.callbacks = self._callbacks()
        library.component = library.fmi2Instantiate(
            name.encode(),
            fmi2.fmi2CoSimulation if is_slave else fmi2.fmi2ModelExchange,
            library.guid.encode(),
            (uri or self.resource_uri).encode(),
            byref(library.callbacks),
            fmi2.fmi2False,
            fmi2.fmi2False,
        )
        if library.component is None:
            library.freeLibrary()
            raise RuntimeError("fmi2Instantiate returns no instance")
        instance: Instance = (CosimulationInstance if is_slave else ExchangeInstance)(self, library)
        try:
            yield instance
        finally:
            library.freeInstance()

    def _variables(self, causality: str, variability: str | None = None) -> list[Any]:
        return [
            variable
            for variable in self.description.modelVariables
            if variable.type == "Real"
            and variable.causality == causality
            and variability in (None, variable.variability or "continuous")
        ]

    def _recorded(self) -> list[Any]:
        """Real outputs, or for want of any the first local variables."""
        return self._variables("output") or self._variables("local")[:_MOST_LOCALS]

    def _callbacks(self) -> Any:
        def log(_environment: int, _name: bytes, _status: int, _category: bytes, message: bytes) -> None:
            self.messages.append((message or b"").decode(errors="replace"))

        def allocate(count: int, size: int) -> int | None:
            block: int | None = fmpy.calloc(count, size)
            if block:
                self.blocks.add(block)
            return block

        def free(block: int | None) -> None:
            self.blocks.discard(block or 0)
            fmpy.free(block)

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(allocate)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        return callbacks


def _time(experiment: Any, key: str) -> float | None:
    value = getattr(experiment, key, None)
    return None if value is None else float(value)


def size_of(variable: Any) -> float:
    """Order of magnitude of a variable: its nominal, its start, or 1."""
    if variable.nominal is not None and float(variable.nominal) != 0.0:
        return abs(float(variable.nominal))
    return abs(float(variable.start or 0.0)) or 1.0


def _excited(variable: Any, phase: float) -> float:
    value = float(variable.start or 0.0) + EXCITATION * size_of(variable) * math.sin(0.1 * phase)
    low = -math.inf if variable.min is None else float(variable.min)
    high = math.inf if variable.max is None else float(variable.max)
    return min(max(value, low), high)

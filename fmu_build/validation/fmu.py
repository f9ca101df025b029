"""An FMU under test: its default experiment, the variables to look at, and instances of it on request."""

from __future__ import annotations

import ctypes
import math
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from copy import copy
from ctypes import byref
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import fmi2
from fmpy.logging import addLoggerProxy

from flexfmu.fmu_build.validation.instance import CosimulationInstance, ExchangeInstance, InstanceUnderTest, RealArray
from flexfmu.fmu_build.validation.library import (
    GUARD,
    FMU2ModelLibrary,
    FMU2SlaveLibrary,
    MisbehaviourError,
    is_guarded,
)
from flexfmu.fmu_build.validation.variables import is_smooth, size_of, start_of, start_value, within

_DEFAULT_STEPS = 500
"""Communication steps of an FMU that proposes no step size."""

MOST_STEPS = 300
"""Communication steps that a run has, but for the one over the whole default experiment."""

SECONDS_A_RUN = 1.0
"""Longest time for a run of so many steps [s]; a slow FMU makes fewer."""

EXCITATION = 1e-3
"""Amplitude of what is added to the inputs' start values, relative to their size: small enough for any model."""

SOLVER_TOLERANCE = 1e-6
"""Assumed relative tolerance of a solver, unless the default experiment has a larger one."""

_MOST_LOCALS = 100

_made, _alive = Counter[Path](), Counter[Path]()
"""Folder of an FMU → how many instances this process has made so far, and has now, of both interfaces."""

_NUMBERS = {"Real", "Integer", "Enumeration", "Boolean"}


class InterfaceType(Enum):
    """The two interfaces of FMI 2.0."""

    COSIMULATION = "co-simulation"
    EXCHANGE = "model exchange"


class OnlyOnceError(Exception):
    """A second instance is asked for in a process, of an FMU that allows only one."""


class NoMoreInstancesError(RuntimeError):
    """An instance that isn't made although all earlier ones of the process have been freed."""


@dataclass
class FmuUnderTest:
    """An extracted FMU with its default experiment; collects what its instances log and allocate.

    Attributes:
        description: model description as fmpy reads it.
        folder: the extracted FMU.
        kind: the interface under test.
        pace: how long a communication step takes, where that is known [s].
        messages: log messages of all instances so far.
        memory: what instances got through the callbacks and have not freed, address → block with its guards.
        misuse: what they did wrong with it.
    """

    description: Any
    folder: Path
    kind: InterfaceType
    pace: float = 0.0
    messages: list[str] = field(default_factory=list)
    memory: dict[int, Any] = field(default_factory=dict)
    misuse: list[str] = field(default_factory=list)
    _instances: int = 0
    _library: Any = None
    _kept_callbacks: Any = None
    _functions: Any = None

    def __post_init__(self) -> None:
        # a time span and a step, by the default experiment as far as it says
        experiment = self.description.defaultExperiment
        self.start = _time(experiment, "startTime") or 0.0
        stop = _time(experiment, "stopTime") or 0.0
        if stop <= self.start:
            stop = self.start + 1.0
        step = _time(experiment, "stepSize") or 0.0
        self.step = step if step > 0.0 else (stop - self.start) / _DEFAULT_STEPS
        self.all_steps = max(1, round((stop - self.start) / self.step))
        self.stop = max(stop, self.start + self.all_steps * self.step)
        # errors below this one are the solver's
        self.tolerance = _time(experiment, "tolerance")
        self.accuracy = max(self.tolerance or 0.0, SOLVER_TOLERANCE)
        # what is watched and moved; some FMUs have nothing but local variables
        self.outputs = self._variables("output", types=_NUMBERS) or self._variables("local")[:_MOST_LOCALS]
        self.inputs = self._variables("input", variability="continuous")

    @property
    def steps(self) -> int:
        """Communication steps of a run: of a slow FMU few."""
        affordable = int(SECONDS_A_RUN / self.pace) if self.pace else MOST_STEPS
        return min(self.all_steps, MOST_STEPS, max(affordable, 4))

    @property
    def element(self) -> Any:
        """The description's element of this interface."""
        description = self.description
        return description.coSimulation if self.kind is InterfaceType.COSIMULATION else description.modelExchange

    @property
    def can_save(self) -> bool:
        """Whether states can be saved and restored."""
        return bool(self.element.canGetAndSetFMUstate)

    @property
    def can_serialize(self) -> bool:
        """Whether saved states can be turned into bytes."""
        return self.can_save and bool(self.element.canSerializeFMUstate)

    @property
    def is_single(self) -> bool:
        """Whether a process may have one instance only."""
        return bool(self.element.canBeInstantiatedOnlyOncePerProcess)

    @property
    def has_variable_step(self) -> bool:
        """Whether a communication step of any size may be made."""
        return self.kind is InterfaceType.COSIMULATION and bool(self.element.canHandleVariableCommunicationStepSize)

    def input_values(self, n: int, size: float = 1.0) -> RealArray:
        """Inputs at step ``n``: their starts, and a little more that changes from step to step; shape (inputs,)."""
        return np.array(
            [
                within(
                    variable, start_of(variable) + size * EXCITATION * size_of(variable) * math.sin(0.1 * (n + 7.0 * k))
                )
                for k, variable in enumerate(self.inputs)
            ]
        )

    @property
    def smooth_outputs(self) -> list[Any]:
        """Recorded variables that change continuously: those that solvers can be judged by."""
        return [variable for variable in self.outputs if is_smooth(variable)]

    @property
    def states(self) -> list[Any]:
        """Variables of the continuous states, in their order."""
        return [unknown.variable.derivative for unknown in self.description.derivatives or ()]

    def settable(self, *causalities: str) -> list[Any]:
        """Variables of these causalities with an exact start, which may be set before the initialisation."""
        return [
            variable
            for variable in self.description.modelVariables
            if variable.causality in causalities
            and variable.variability != "constant"
            and (variable.initial == "exact" or variable.causality == "input")
            and start_value(variable) is not None
        ]

    @property
    def resource_uri(self) -> str:
        """Where the resources are, as a file URI."""
        return (self.folder / "resources").absolute().as_uri()

    @contextmanager
    def instance(self, name: str, guid: str | None = None, uri: str | None = None) -> Iterator[Any]:
        """An instance that is freed at the end; ``guid`` and ``uri`` replace the right ones.

        The library stays loaded, as it does in most masters.

        Raises:
            OnlyOnceError: the FMU allows one instance a process, and there was one.
            NoMoreInstancesError: fmi2Instantiate returns nothing, but did return instances before.
            MisbehaviourError: fmi2Instantiate returns nothing.
            Exception: as fmpy does, if the library cannot be loaded.
        """
        if self.is_single and self._instances:
            raise OnlyOnceError
        self._instances += 1
        # a copy of the loaded library with an instance of its own
        is_slave = self.kind is InterfaceType.COSIMULATION
        library: Any = copy(self.library())
        library.callbacks = self._callbacks()
        library.component = library.fmi2Instantiate(
            name.encode(),
            fmi2.fmi2CoSimulation if is_slave else fmi2.fmi2ModelExchange,
            (guid or self.description.guid).encode(),
            (uri or self.resource_uri).encode(),
            byref(library.callbacks),
            fmi2.fmi2False,
            fmi2.fmi2False,
        )
        # why there is none: the process has had its share, or the FMU fails
        if library.component is None and guid is uri is None and _made[self.folder] and not _alive[self.folder]:
            raise NoMoreInstancesError(
                f"fmi2Instantiate returns no instance in a process that has made and freed {_made[self.folder]}"
            )
        if library.component is None:
            raise MisbehaviourError("fmi2Instantiate returns no instance", "log why, or give one")
        _made[self.folder] += 1
        _alive[self.folder] += 1
        # freed however the check ends
        instance: InstanceUnderTest = (CosimulationInstance if is_slave else ExchangeInstance)(self, library)
        try:
            yield instance
        finally:
            _alive[self.folder] -= 1
            library.fmi2FreeInstance(library.component)

    def library(self) -> Any:
        """The loaded library.

        Raises:
            Exception: as fmpy does, if it cannot be loaded.
        """
        if self._library is None:
            self._library = (FMU2SlaveLibrary if self.kind is InterfaceType.COSIMULATION else FMU2ModelLibrary)(
                guid=self.description.guid,
                modelIdentifier=self.element.modelIdentifier,
                unzipDirectory=str(self.folder),
                instanceName="validated",
            )
        return self._library

    def _variables(self, causality: str, variability: str | None = None, types: set[str] | None = None) -> list[Any]:
        return [
            variable
            for variable in self.description.modelVariables
            if variable.type in (types or {"Real"})
            and variable.causality == causality
            and variability in (None, variable.variability or "continuous")
        ]

    def _callbacks(self) -> Any:
        """The callbacks of all instances: they must exist as long as these."""
        if self._kept_callbacks is None:
            self._kept_callbacks = self._new_callbacks()
        return self._kept_callbacks

    def _new_callbacks(self) -> Any:
        def log(_environment: int, _name: bytes, _status: int, _category: bytes, message: bytes) -> None:
            self.messages.append((message or b"").decode(errors="replace"))

        # each block lies between guards and is kept until the FMU frees it
        def allocate(count: int, size: int) -> int | None:
            block = ctypes.create_string_buffer(GUARD + bytes(count * size) + GUARD, count * size + 2 * len(GUARD))
            address = ctypes.addressof(block) + len(GUARD)
            self.memory[address] = block
            return address

        def free(address: int | None) -> None:
            block = self.memory.pop(address or 0, None)
            if block is None and address:
                self.misuse.append("frees through freeMemory what allocateMemory has not allocated")
            elif block is not None and not is_guarded(block):
                self.misuse.append(f"writes beyond a block of {len(block) - 2 * len(GUARD)} bytes")

        # fmpy's structure, with references that keep the functions alive
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(allocate)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        with suppress(Exception):  # puts arguments into messages, where fmpy has it for this platform
            self._functions = callbacks.logger, callbacks.allocateMemory, callbacks.freeMemory
            addLoggerProxy(byref(callbacks))
        return callbacks


def _time(experiment: Any, key: str) -> float | None:
    value = getattr(experiment, key, None)
    return None if value is None else float(value)

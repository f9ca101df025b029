"""An FMU under test: its default experiment, the observed variables, and its instances."""

from __future__ import annotations

import ctypes
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from copy import copy
from ctypes import byref
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import fmi2, fmi3
from fmpy.logging import addLoggerProxy

from flexfmu.fmu_build.validation.fmi3 import FMU3ModelLibrary, FMU3SlaveLibrary
from flexfmu.fmu_build.validation.instance import (
    GUARD,
    CosimulationInstance,
    ExchangeInstance,
    FMU2ModelLibrary,
    FMU2SlaveLibrary,
    InstanceUnderTest,
    MisbehaviourError,
    RealArray,
    is_guarded,
)
from flexfmu.fmu_build.validation.variables import is_smooth, size_of, start_of, start_value, within

_DEFAULT_STEPS = 500
"""Communication steps of the default experiment if the FMU proposes no step size."""

MOST_STEPS = 300
"""Most communication steps of a run; only the check of the simulation runs the whole default experiment."""

SECONDS_A_RUN = 1.0
"""Longest wall time of a run [s]; a slow FMU makes fewer than `MOST_STEPS` steps."""

EXCITATION = 1e-3
"""Amplitude of the excitation of inputs about their start values, relative to their size; small enough for any model."""

SOLVER_TOLERANCE = 1e-6
"""Assumed relative tolerance of a solver, unless the default experiment has a larger one."""

_MOST_LOCALS = 100

_made, _alive = Counter[Path](), Counter[Path]()
"""Folder of an FMU → number of instances of both interfaces that this process has made so far, and that exist now."""

_NUMBERS = {"Real", "Integer", "Enumeration", "Boolean"}


class InterfaceType(Enum):
    """The two interfaces of FMI 2.0."""

    COSIMULATION = "co-simulation"
    EXCHANGE = "model exchange"


class OnlyOnceError(Exception):
    """A check needs a second instance of an FMU that allows one per process."""


class NoMoreInstancesError(RuntimeError):
    """fmi2Instantiate fails although all earlier instances of the process have been freed."""


@dataclass
class FmuUnderTest:
    """An extracted FMU with its default experiment; collects log messages and memory of its instances.

    Attributes:
        description: model description as read by fmpy.
        folder: folder of the extracted FMU.
        kind: the interface under test.
        step_seconds: wall time of a communication step [s]; 0 if unknown.
        messages: log messages of all instances so far.
        categories: the categories of log messages so far.
        memory: blocks of allocateMemory that are not freed, address → block with its guards.
        misuse: wrong uses of these blocks, as parts of sentences.
    """

    description: Any
    folder: Path
    kind: InterfaceType
    step_seconds: float = 0.0
    messages: list[str] = field(default_factory=list)
    categories: set[str] = field(default_factory=set)
    memory: dict[int, Any] = field(default_factory=dict)
    misuse: list[str] = field(default_factory=list)
    _instances: int = 0
    _kept: list[Any] = field(
        default_factory=list
    )  # callbacks, of replaced copies too: fmpy's logger has a pointer to the last ones

    def __post_init__(self) -> None:
        # times from the default experiment, defaults where it has none
        experiment = self.description.defaultExperiment
        given = {key: float(getattr(experiment, key, None) or 0.0) for key in ("startTime", "stopTime", "stepSize")}
        self.start, stop = given["startTime"], given["stopTime"]
        if stop <= self.start:
            stop = self.start + 1.0
        self.step = given["stepSize"] if given["stepSize"] > 0.0 else (stop - self.start) / _DEFAULT_STEPS
        self.step = min(self.description.clocks.values(), default=self.step) if self.is_fmi3 else self.step
        self.all_steps = max(1, round((stop - self.start) / self.step))
        self.stop = max(stop, self.start + self.all_steps * self.step)
        # errors below the accuracy are due to the solver
        tolerance = getattr(experiment, "tolerance", None)
        self.tolerance = None if tolerance is None else float(tolerance)
        self.accuracy = max(self.tolerance or 0.0, SOLVER_TOLERANCE)
        # observed and excited variables; some FMUs have only local variables
        self.outputs = self._variables("output", types=_NUMBERS) or self._variables("local")[:_MOST_LOCALS]
        self.inputs = [each for each in self._variables("input") if each.clocks or is_smooth(each)]

    @property
    def steps(self) -> int:
        """Communication steps of a run; fewer for a slow FMU, at least 4 unless the experiment is shorter."""
        affordable = int(SECONDS_A_RUN / self.step_seconds) if self.step_seconds else MOST_STEPS
        return min(self.all_steps, MOST_STEPS, max(affordable, 4))

    @property
    def element(self) -> Any:
        """Element CoSimulation or ModelExchange of the description."""
        description = self.description
        return description.coSimulation if self.kind is InterfaceType.COSIMULATION else description.modelExchange

    @property
    def is_fmi3(self) -> bool:
        """Whether the FMU is one of FMI 3.0."""
        return bool(self.description.fmiMajorVersion == 3)

    @property
    def can_save(self) -> bool:
        """Whether states can be saved and restored."""
        return bool(self.element.canGetAndSetFMUstate)

    @property
    def can_serialize(self) -> bool:
        """Whether saved states can be serialised."""
        return self.can_save and bool(self.element.canSerializeFMUstate)

    @property
    def is_single(self) -> bool:
        """Whether a process may instantiate the FMU only once."""
        return bool(self.element.canBeInstantiatedOnlyOncePerProcess)

    @property
    def has_variable_step(self) -> bool:
        """Whether the FMU is a slave that accepts communication steps of any size."""
        return self.kind is InterfaceType.COSIMULATION and bool(self.element.canHandleVariableCommunicationStepSize)

    def input_values(self, n: int, size: float = 1.0) -> RealArray:
        """Inputs at step ``n``, shape (inputs,): start values plus a sinusoidal excitation, multiplied by ``size``."""
        wave = size * EXCITATION * np.sin(0.1 * (n + 7.0 * np.arange(len(self.inputs))))
        changes = zip(self.inputs, wave.tolist(), strict=True)
        return np.array([within(each, start_of(each) + change * size_of(each)) for each, change in changes])

    @property
    def smooth_outputs(self) -> list[Any]:
        """Continuous outputs: only these reveal errors of a solver."""
        return [variable for variable in self.outputs if is_smooth(variable)]

    @property
    def real_inputs(self) -> list[Any]:
        """Real inputs that may be set at any time: in model exchange discrete ones may be set only in Event Mode."""
        return self.inputs if self.kind is InterfaceType.EXCHANGE else self._variables("input")

    @property
    def times(self) -> list[Any]:
        """The independent variable; empty if the FMU has none."""
        return self._variables("independent")[:1]

    @property
    def perturbable_states(self) -> list[Any]:
        """States whose start values may be set."""
        return [variable for variable in self.states if variable in self.settable("output", "local")]

    @property
    def states(self) -> list[Any]:
        """Variables of the continuous states, in their order."""
        return [unknown.variable.derivative for unknown in self.description.derivatives or ()]

    def settable(self, *causalities: str) -> list[Any]:
        """Variables of these causalities that may be set before initialisation and have a start value."""
        return [
            variable
            for variable in self.description.modelVariables
            if variable.causality in causalities
            and variable.variability != "constant"
            and (variable.initial == "exact" or variable.causality == "input")
            and start_value(variable) is not None
        ]

    @contextmanager
    def instance(self, name: str, guid: str | None = None, uri: str | None = None) -> Iterator[Any]:
        """Make an instance and free it at the end; ``guid`` and ``uri`` replace the correct ones.

        The library stays loaded, as in most masters.

        Raises:
            OnlyOnceError: the FMU allows one instance per process, and this process has made one.
            NoMoreInstancesError: fmi2Instantiate returns NULL although it succeeded before.
            MisbehaviourError: fmi2Instantiate returns NULL.
            Exception: fmpy can't load the library; its type depends on the cause.
        """
        if self.is_single and self._instances:
            raise OnlyOnceError
        self._instances += 1
        # a copy of the loaded library with its own component
        is_slave = self.kind is InterfaceType.COSIMULATION
        library: Any = copy(self.library)
        identity, resources = (guid or self.description.guid).encode(), (self.folder / "resources").absolute()
        if self.is_fmi3:
            library.types, library.clocks = self.description.types, self.description.clocks
            library.component = library.make(name.encode(), identity, f"{resources}{os.sep}".encode(), self._log)
        else:
            library.callbacks = self._callbacks
            library.component = library.fmi2Instantiate(
                name.encode(),
                fmi2.fmi2CoSimulation if is_slave else fmi2.fmi2ModelExchange,
                identity,
                (uri or resources.as_uri()).encode(),
                byref(library.callbacks),
                fmi2.fmi2False,
                fmi2.fmi2False,
            )
        # NULL: a limited number of instances per process, or a failure
        if library.component is None and guid is uri is None and _made[self.folder] and not _alive[self.folder]:
            raise NoMoreInstancesError(
                f"fmi2Instantiate returns no instance in a process that has made and freed {_made[self.folder]}"
            )
        if library.component is None:
            raise MisbehaviourError("fmi2Instantiate returns no instance", "log why, or give one")
        _made[self.folder] += 1
        _alive[self.folder] += 1
        # free the instance even if the check fails
        instance: InstanceUnderTest = (CosimulationInstance if is_slave else ExchangeInstance)(self, library)
        try:
            yield instance
        finally:
            _alive[self.folder] -= 1
            library.fmi2FreeInstance(library.component)

    @contextmanager
    def initialized(self, name: str) -> Iterator[Any]:
        """An initialised instance; errors as for `instance`."""
        with self.instance(name) as instance:
            instance.initialize()
            yield instance

    def record(self, name: str) -> RealArray:
        """The results of a whole run in an instance of its own, one row per step."""
        with self.instance(name) as instance:
            return np.asarray(instance.run())

    @cached_property
    def library(self) -> Any:
        """The loaded library.

        Raises:
            Exception: fmpy can't load it; its type depends on the cause.
        """
        kinds = (FMU3ModelLibrary, FMU3SlaveLibrary) if self.is_fmi3 else (FMU2ModelLibrary, FMU2SlaveLibrary)
        return kinds[self.kind is InterfaceType.COSIMULATION](
            guid=self.description.guid,
            modelIdentifier=self.element.modelIdentifier,
            unzipDirectory=str(self.folder),
            instanceName="validated",
        )

    def _variables(self, causality: str, variability: str | None = None, types: set[str] | None = None) -> list[Any]:
        return [
            variable
            for variable in self.description.modelVariables
            if variable.type in (types or {"Real"})
            and variable.causality == causality
            and variability in (None, variable.variability or "continuous")
        ]

    @cached_property
    def _log(self) -> Any:
        """The logger of FMI 3.0."""

        return fmi3.fmi3LogMessageCallback(lambda _environment, _status, *texts: self._collect(*texts))

    def _collect(self, category: bytes | None, message: bytes | None) -> None:
        self.categories.add((category or b"").decode(errors="replace"))
        self.messages.append((message or b"").decode(errors="replace"))

    @cached_property
    def _callbacks(self) -> Any:
        """The callbacks of all instances."""

        def log(_environment: int, _name: bytes, _status: int, category: bytes, message: bytes) -> None:
            self._collect(category, message)

        # each block lies between guards; Python keeps it until the FMU frees it
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

        # fmpy's structure; the references keep the functions alive
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(allocate)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        with suppress(Exception):  # formats variadic log messages; fmpy has it on some platforms only
            self._kept.append((callbacks, callbacks.logger, callbacks.allocateMemory, callbacks.freeMemory))
            addLoggerProxy(byref(callbacks))
        return callbacks

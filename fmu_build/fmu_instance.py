"""An FMU's instances over fmpy, as far as validation needs them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2
from numpy.typing import NDArray

_DEFAULT_STEPS = 500
"""Communication steps of an FMU that proposes no step size."""


@dataclass
class FmuUnderTest:
    """An extracted FMU with its default experiment; collects what its instances log.

    Attributes:
        description: model description as fmpy reads it.
        folder: the extracted FMU.
        maximum_steps: communication steps that a run has at most.
        messages: log messages of all instances so far.
    """

    description: Any
    folder: Path
    maximum_steps: int
    messages: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        experiment = self.description.defaultExperiment
        self.start = float(getattr(experiment, "startTime", None) or 0.0)
        stop = float(getattr(experiment, "stopTime", None) or self.start + 1.0)
        self.step = float(getattr(experiment, "stepSize", None) or (stop - self.start) / _DEFAULT_STEPS)
        self.steps = max(1, min(round((stop - self.start) / self.step), self.maximum_steps))
        self.stop = max(stop, self.start + self.steps * self.step)
        tolerance = getattr(experiment, "tolerance", None)
        self.tolerance = None if tolerance is None else float(tolerance)
        outputs = [v for v in self.description.modelVariables if v.causality == "output" and v.type == "Real"]
        self.output_names = [variable.name for variable in outputs]
        self.output_references = [variable.valueReference for variable in outputs]

    @property
    def can_save(self) -> bool:
        """Whether states can be saved and restored."""
        return bool(self.description.coSimulation.canGetAndSetFMUstate)

    @property
    def can_serialize(self) -> bool:
        """Whether saved states can be turned into bytes."""
        return self.can_save and bool(self.description.coSimulation.canSerializeFMUstate)

    @property
    def can_have_two(self) -> bool:
        """Whether several instances may live in one process."""
        return not self.description.coSimulation.canBeInstantiatedOnlyOncePerProcess

    @contextmanager
    def instance(self, name: str, guid: str | None = None) -> Iterator[FmuInstance]:
        """An instance that is freed at the end; ``guid`` replaces the right one.

        Raises:
            Exception: as fmpy does, if fmi2Instantiate returns nothing.
        """
        slave = fmi2.FMU2Slave(
            guid=guid or self.description.guid,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            unzipDirectory=str(self.folder),
            instanceName=name,
        )
        try:
            slave.instantiate(callbacks=self._callbacks())
        except Exception:
            slave.freeLibrary()
            raise
        try:
            yield FmuInstance(self, slave)
        finally:
            slave.freeInstance()

    def _callbacks(self) -> Any:
        def log(_environment: int, _name: bytes, _status: int, _category: bytes, message: bytes) -> None:
            self.messages.append(message.decode(errors="replace"))

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        return callbacks


class FmuInstance:
    """One instance; a failed FMI call raises fmpy's exception."""

    def __init__(self, fmu: FmuUnderTest, slave: Any) -> None:
        self._fmu = fmu
        self._slave = slave

    def version(self) -> tuple[str, str]:
        """FMI version and types platform that the binary tells."""
        return self._slave.getVersion(), self._slave.getTypesPlatform()

    def initialize(self) -> None:
        """Everything up to the first communication step, with the default experiment."""
        fmu = self._fmu
        self._slave.setupExperiment(tolerance=fmu.tolerance, startTime=fmu.start, stopTime=fmu.stop)
        self._slave.enterInitializationMode()
        self._slave.exitInitializationMode()

    def advance(self, first: int, last: int) -> NDArray[np.float64]:
        """Make the communication steps ``first`` to ``last``; outputs after each, shape (last - first, outputs)."""
        fmu = self._fmu
        rows = []
        for n in range(first, last):
            self._slave.doStep(fmu.start + n * fmu.step, fmu.step)
            rows.append(self._slave.getReal(fmu.output_references))
        return np.array(rows, dtype=np.float64).reshape(last - first, -1)

    def run(self) -> NDArray[np.float64]:
        """The whole default experiment; outputs after each step, shape (steps, outputs)."""
        self.initialize()
        outputs = self.advance(0, self._fmu.steps)
        self._slave.terminate()
        return outputs

    def reset(self) -> None:
        """Back to the state after instantiation."""
        self._slave.reset()

    def save(self) -> Any:
        """The complete state; give it back with `discard`."""
        return self._slave.getFMUstate()

    def restore(self, state: Any) -> None:
        """Continue from a saved state."""
        self._slave.setFMUstate(state)

    def discard(self, state: Any) -> None:
        """Free a saved state."""
        self._slave.freeFMUstate(state)

    def serialize(self) -> bytes:
        """The complete state as bytes."""
        state = self.save()
        data: bytes = self._slave.serializeFMUstate(state)
        self.discard(state)
        return data

    def restore_serialized(self, data: bytes) -> None:
        """Continue from the bytes of another instance's state."""
        state = self._slave.deSerializeFMUstate(data)
        self.restore(state)
        self.discard(state)

"""An instance of an FMU, driven call by call."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from numpy.typing import NDArray


class Instance:
    """One instance, addressed by names; a refused call raises `RefusedError` with the FMU's own sentence."""

    def __init__(self, slave: Any, description: Any, messages: list[str]) -> None:
        self.slave = slave
        self.messages = messages
        self.references = {each.name: each.valueReference for each in description.modelVariables}
        names = [(each.name, each.causality) for each in description.modelVariables if each.type == "Real"]
        self.inputs = [name for name, causality in names if causality == "input"]
        self.outputs = [name for name, causality in names if causality == "output"]
        self.time = 0.0

    def start(self, time: float = 0.0, stop: float | None = None, **values: float) -> Instance:
        """From instantiation to the first step, with start values."""
        self.time = time
        self.call("setupExperiment", startTime=time, stopTime=stop)
        for name, value in values.items():
            self.set(name, value)
        self.call("enterInitializationMode")
        self.call("exitInitializationMode")
        return self

    def call(self, function: str, *arguments: Any, **named: Any) -> Any:
        """Call an FMI function.

        Raises:
            RefusedError: it returned discard or an error.
        """
        self.messages.clear()
        try:
            return getattr(self.slave, function)(*arguments, **named)
        except FMICallException as error:
            raise RefusedError(" ".join(self.messages) or str(error)) from None

    def set(self, name: str, value: float) -> None:
        """Set a Real variable."""
        self.call("setReal", [self.references[name]], [value])

    def set_inputs(self, values: Sequence[float] | NDArray[np.float64]) -> None:
        """Set all inputs."""
        self.call("setReal", [self.references[name] for name in self.inputs], [float(value) for value in values])

    def set_derivatives(self, name: str, derivatives: Sequence[float]) -> None:
        """Set the derivatives of an input, from the first on."""
        orders = list(range(1, len(derivatives) + 1))
        self.call("setRealInputDerivatives", [self.references[name]] * len(orders), orders, list(derivatives))

    def get(self, name: str) -> float:
        """Read a Real variable."""
        return float(self.call("getReal", [self.references[name]])[0])

    def get_outputs(self) -> list[float]:
        """Read all outputs."""
        return list(self.call("getReal", [self.references[name] for name in self.outputs]))

    def get_derivatives(self, order: int) -> list[float]:
        """Read a derivative of all outputs."""
        references = [self.references[name] for name in self.outputs]
        return list(self.call("getRealOutputDerivatives", references, [order] * len(references)))

    def samples(self) -> int:
        """Completed samples."""
        return int(self.call("getInteger", [self.references["statistics.samples"]])[0])

    def step(self, size: float, until: float | None = None) -> None:
        """Make a communication step; ``until`` is the time after it where a sum would round."""
        self.call("doStep", currentCommunicationPoint=self.time, communicationStepSize=size)
        self.time = self.time + size if until is None else until


class RefusedError(Exception):
    """A call that the FMU refused."""


@contextmanager
def opened(path: Path, tmp_path: Path) -> Iterator[Any]:
    """An extracted FMU: a function that makes an instance, which is freed at the end."""
    folder = tmp_path / f"{path.stem}-unpacked"
    fmpy.extract(str(path), unzipdir=str(folder))
    description = fmpy.read_model_description(str(path))
    slaves: list[FMU2Slave] = []

    def make(name: str = "instance") -> Instance:
        messages: list[str] = []

        def hear(_environment: Any, _name: bytes, _status: int, _category: bytes, message: bytes) -> None:
            messages.append(message.decode())

        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(hear)
        slave = FMU2Slave(
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=str(folder),
            instanceName=name,
        )
        slave.instantiate(callbacks=callbacks)
        slave.keep = callbacks
        slaves.append(slave)
        return Instance(slave, description, messages)

    try:
        yield make
    finally:
        for slave in slaves:
            slave.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)


def run(
    instance: Instance, inputs: NDArray[np.float64], sample_time: float, rollback: int = 0, **values: float
) -> NDArray[np.float64]:
    """Outputs (N, outputs) at the sample instants, the inputs (N, inputs) being set there.

    Before every ``rollback``-th sample the instance makes three others, in the middle of a step too, and is restored, which leaves
    no trace; not at all where it is 0.
    """
    instance.start(**values)
    rows = []
    for k, u in enumerate(inputs):
        if rollback and k % rollback == rollback // 2:
            state, time = instance.call("getFMUstate"), instance.time
            for other in inputs[::-1][k : k + 3]:
                instance.set_inputs(other)
                instance.step(1.5 * sample_time)
            instance.call("setFMUstate", state)
            instance.call("freeFMUstate", state)
            instance.time = time
        instance.set_inputs(u)
        rows.append(instance.get_outputs())
        instance.step(sample_time, until=(k + 1) * sample_time)
    return np.array(rows)

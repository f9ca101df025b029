"""The FMU of a discrete-time block as a sampled slave: the master lands on its instants and holds its outputs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from flexfmu.cosim.errors import FmuFileError, InputError
from flexfmu.cosim.fmu.annotations import sampling
from flexfmu.cosim.fmu.file import open_fmu
from flexfmu.cosim.fmu.slave import FmuSlave
from flexfmu.cosim.fmu.variables import Value
from flexfmu.cosim.master.binding import nothing
from flexfmu.cosim.slave import Call, Indices, RealArray


def fmu_slave(
    path: str | Path, name: str = "fmu", parameters: Mapping[str, Value] | None = None
) -> SampledFmu | FmuSlave:
    """The slave that suits an FMU: sampled if it tells its sample time, as exported blocks do; stepped if not.

    Raises:
        FmuFileError, InputError: as `SampledFmu` and `FmuSlave`.
    """
    is_sampled = sampling(open_fmu(Path(path))) is not None
    return SampledFmu(path, name, parameters) if is_sampled else FmuSlave(path, name, parameters)


class SampledFmu:
    """An exported block in the master, sampled as its Python twin is: same instants, same order, same numbers.

    The FMU stands at its last sample, which it completes with the inputs that it was given there; what is set between
    instants waits for the next.

    Args:
        path: an FMU that `flexfmu.fmu_build.block_build` has made.
        name: name of the slave.
        parameters: start values of parameters and inputs by name.

    Attributes:
        path: the FMU file.

    Raises:
        FmuFileError: the FMU is missing or broken, or doesn't tell its sample time.
        InputError: a parameter doesn't exist or its value doesn't suit its type.
    """

    def __init__(self, path: str | Path, name: str = "fmu", parameters: Mapping[str, Value] | None = None) -> None:
        times = sampling(open_fmu(Path(path)))
        if times is None:
            raise FmuFileError(f"{path} doesn't tell its sample time; run it as a slave that is stepped")
        self.name = name
        self.sample_time, self.offset = times
        self._fmu = FmuSlave(path, name, parameters, input_order=0)
        self.path, self.parameters = self._fmu.path, self._fmu.parameters
        self.variables, self.feedthrough = self._fmu.variables, self._fmu.feedthrough
        self._inputs = np.array([i for i, each in enumerate(self.variables) if each.causality == "input"], np.intp)
        self._values = np.zeros(len(self.variables))
        self._send = nothing
        self._time: float | None = None

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Begin a run; inputs that were set before are the initial ones."""
        self._fmu.initialize(start_time, stop_time, tolerance)
        buffer = np.empty(self._inputs.size)
        self._fmu.get(self._inputs, buffer)
        self._values[self._inputs] = buffer
        self._time = start_time
        self._send = self._sender()

    def _sender(self) -> Call:
        """A call that hands the inputs to the FMU."""
        if not self._inputs.size:
            return nothing
        buffer = np.empty(self._inputs.size)
        send = self._fmu.bind_set(self._inputs, buffer)

        def call() -> None:
            self._values.take(self._inputs, None, buffer, "clip")
            send()

        return call

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs, which count at the next instant.

        Raises:
            InputError: a variable is no input.
        """
        if not np.isin(indices, self._inputs).all():
            raise InputError(f"{self.name}: only inputs can be set; give parameters when the slave is made")
        self._values[indices] = values
        if self._time is None:
            self._fmu.set(indices, values)

    def get(self, indices: Indices, values: RealArray) -> None:
        """Current values of the FMU's variables."""
        self._fmu.get(indices, values)

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        """A call that sets inputs from ``values`` (n,)."""
        return lambda: self.set(indices, values)

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        """A call that reads variables into ``values`` (n,)."""
        return self._fmu.bind_get(indices, values)

    def bind_set_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """Inputs are sampled; their derivatives mean nothing here."""
        raise InputError(f"{self.name} is sampled and takes no input derivatives")

    def bind_get_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """Outputs are held; their derivatives are not offered."""
        raise InputError(f"{self.name} is sampled and gives no output derivatives")

    def output(self, time: float) -> None:
        """Take the sample at ``time`` with the inputs set so far; may be repeated there."""
        if self._time is not None and time > self._time:
            self._fmu.step(self._time, time - self._time)
            self._time = time
        self._send()

    def update(self, time: float) -> None:
        """The inputs just set are those with which the FMU completes the sample."""
        self.output(time)

    def sample(self, time: float) -> None:
        """Take the sample at ``time`` with the inputs just set."""
        self.output(time)

    def step(self, time: float, step: float) -> None:
        """Nothing happens between the sample instants: the outputs are held."""

    def save(self) -> object:
        """State of the FMU, its time and the inputs."""
        return self._fmu.save(), self._time, self._values.copy()

    def restore(self, state: object) -> None:
        """Go back to what `save` gave.

        Raises:
            InputError: the state belongs to another kind of slave.
        """
        if not (isinstance(state, tuple) and len(state) == 3):
            raise InputError(f"{self.name}: this state was not saved by this slave")
        saved, self._time, values = state
        self._fmu.restore(saved)
        self._values[:] = values

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one."""
        if isinstance(state, tuple):
            self._fmu.release(state[0])

    def terminate(self) -> None:
        """End the run and free the FMU's instance."""
        self._time = None
        self._send = nothing
        self._fmu.terminate()

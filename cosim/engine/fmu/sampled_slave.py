"""FMUs as sampled slaves: stepped at their own instants only, inputs sampled, outputs held in between."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from flexfmu.cosim.engine.binding import nothing
from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.engine.errors import FmuFileError, InputError, SlaveError
from flexfmu.cosim.engine.fmu.capabilities import fixed_step
from flexfmu.cosim.engine.fmu.file import UnpackedFmu, open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.slave import Call, Indices, RealArray, check_sampling, feedthrough

PROBES = (1e-3, -1e-3, 1.0, -1.0)
"""Sizes of what is added to all real inputs to see whether outputs follow at once; limits hide one sign, or large ones."""


def fmu_slave(
    path: str | Path,
    name: str = "fmu",
    parameters: Mapping[str, Value] | None = None,
    *,
    sample_time: float | None = None,
    offset: float = 0.0,
    output_order: int | None = None,
) -> SampledFmu | FmuTask | FmuSlave:
    """The slave that suits an FMU: sampled or stepped.

    An exported block states its own sample time. Another FMU is sampled if it is given a sample time, or if it can't vary
    its communication step (canHandleVariableCommunicationStepSize = false) and its default experiment has a step size.
    A sampled FMU either has its outputs at an instant before its step (`SampledFmu`), which is seen from a trial
    instance whose outputs follow its inputs at once, or from a description in which no output depends on an input; or it
    calculates them in fmi2DoStep (`FmuTask`).

    Args:
        path: the FMU file.
        name: name of the slave.
        parameters: start values of parameters and inputs by name.
        sample_time, offset: [s]; None for what the FMU states.
        output_order: highest derivative of its outputs that is asked for, see `FmuSlave`; a sampled FMU holds its outputs.

    Raises:
        FmuFileError: the FMU is missing or broken.
        InputError: a parameter doesn't exist or its value doesn't suit its type, a time is out of range or contradicts
            that of an exported block, or there is an offset without a sample time.
    """
    fmu = open_fmu(Path(path))
    own = fmu.sampling
    if own is not None:
        if (sample_time or own[0], offset or own[1]) != own:
            raise InputError(
                f"{name}: {fmu.path} is a block with a sample time of {own[0]:g} s and an offset of {own[1]:g} s, which "
                f"can't be changed to {sample_time or own[0]:g} s and {offset:g} s; leave them out, or export the block anew"
            )
        return SampledFmu(path, name, parameters)
    chosen = fixed_step(fmu) if sample_time is None else sample_time
    if chosen is None:
        if offset:
            raise InputError(f"{name}: an offset of {offset:g} s needs a sample time; add sample_time in s")
        return FmuSlave(path, name, parameters, output_order=output_order)
    check_sampling(chosen, offset, name)
    slave = FmuSlave(path, name, parameters, input_order=0, output_order=0)
    at_once = _tried(slave, fmu)
    declared = {output: names for output, names in feedthrough(slave).items() if names}
    if not at_once and declared:
        return FmuTask(slave, chosen, offset)
    # an output that follows inputs which its description denies depends on all of them
    honest = {output: names for output, names in slave.feedthrough.items() if names or output not in at_once}
    return SampledFmu(path, name, parameters, (chosen, offset), honest)


def _tried(slave: FmuSlave, fmu: UnpackedFmu) -> frozenset[str]:
    """What `_immediate` finds, in a child process where the FMU might end this one; nothing where it does so."""
    if not AVAILABLE or fmu.is_ours:
        return _immediate(slave)
    try:
        return frozenset(in_child(lambda: _immediate(slave), lambda: None, CALL_LIMIT))
    except ChildLostError:
        return frozenset()  # its run will show what is wrong


def _immediate(slave: FmuSlave) -> frozenset[str]:
    """Outputs that follow real inputs without a step, as a trial instance shows, as far as the FMU goes along."""
    variables = slave.variables
    inputs = np.array([i for i, v in enumerate(variables) if v.causality == "input" and not v.discrete], np.intp)
    outputs = np.array([i for i, v in enumerate(variables) if v.causality == "output"], np.intp)
    if not inputs.size or not outputs.size:
        return frozenset()
    before, after, start = np.empty(outputs.size), np.empty(outputs.size), np.empty(inputs.size)
    # a different share for each, or else differences of inputs stay what they are
    shares = np.random.default_rng(1).uniform(0.5, 1.5, inputs.size)
    found: set[str] = set()
    try:
        slave.initialize(0.0, 1.0, None)
        slave.get(inputs, start)
        slave.get(outputs, before)
        for change in PROBES:
            slave.set(inputs, start + change * shares)
            slave.get(outputs, after)
            moved = (after != before) & np.isfinite(after)
            found |= {variables[i].name for i in outputs[moved]}
    except SlaveError:
        pass
    finally:
        slave.terminate()
    return frozenset(found)


class FmuTask:
    """An FMU that calculates its outputs in fmi2DoStep, as a task of a digital controller does.

    At t_k it gets its inputs, makes the step from t_k to t_k + sample_time, and its outputs are held from t_k on, as
    those of a Python block with y_k = f(x_k, u_k) are. It is initialised at its first instant, so that all of its steps
    have the same length.

    Args:
        slave: the FMU; it is stepped here alone.
        sample_time, offset: [s].

    Attributes:
        path: the FMU file.
        parameters: the start values that were given.
        can_save: whether the FMU can save and restore its state.
    """

    feedthrough: Mapping[str, tuple[str, ...]] = {}

    def __init__(self, slave: FmuSlave, sample_time: float, offset: float = 0.0) -> None:
        self._fmu = slave
        self.name, self.sample_time, self.offset = slave.name, sample_time, offset
        self.path, self.parameters, self.variables = slave.path, slave.parameters, slave.variables
        self.can_save = slave.can_save
        self.set, self.get = slave.set, slave.get
        self.bind_set, self.bind_get = slave.bind_set, slave.bind_get
        self.bind_set_derivatives, self.bind_get_derivatives = slave.bind_set_derivatives, slave.bind_get_derivatives
        self.terminate, self.report, self.take_report = slave.terminate, slave.report, slave.take_report
        self._first, self._count = 0.0, 0

    @property
    def messages(self) -> tuple[str, ...]:
        """What the FMU logged in the last run, warnings and worse."""
        return self._fmu.messages

    @property
    def remarks(self) -> tuple[str, ...]:
        """As of `FmuSlave`."""
        return self._fmu.remarks

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Begin a run at the first instant; the last step ends one sample after the run."""
        self._first, self._count = start_time + self.offset, 0
        self._fmu.initialize(self._first, max(stop_time, self._first) + 2.0 * self.sample_time, tolerance)

    def sample(self, time: float) -> None:
        """Calculate outputs from the inputs just set, and move on to the next instant."""
        self._fmu.step(self._first + self._count * self.sample_time, self.sample_time)
        self._count += 1

    def step(self, time: float, step: float) -> None:
        """Nothing happens between the sample instants: the outputs are held."""

    def save(self) -> object:
        """State of the FMU and the number of samples."""
        return self._fmu.save(), self._count

    def restore(self, state: object) -> None:
        """Go back to what `save` gave.

        Raises:
            InputError: the state belongs to another kind of slave.
        """
        if not (isinstance(state, tuple) and len(state) == 2):
            raise InputError(f"{self.name}: this state was not saved by this slave")
        saved, self._count = state
        self._fmu.restore(saved)

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one."""
        if isinstance(state, tuple):
            self._fmu.release(state[0])


class SampledFmu:
    """An FMU whose outputs at an instant are there before its step, an exported block for example: sampled as its Python
    twin is, same instants, same order, same numbers.

    The FMU stands at its last sample, which it completes with the inputs that it was given there; what is set between
    instants waits for the next.

    Args:
        path: the FMU.
        name: name of the slave.
        parameters: start values of parameters and inputs by name.
        times: sample time and offset [s] of an FMU that isn't an exported block; it is initialised at its first instant,
            so that all of its steps have the same length. None for those of the block.
        feedthrough: output → inputs that it depends on at the same instant; None for what the description says.

    Attributes:
        path: the FMU file.
        can_save: whether the FMU can save and restore its state.

    Raises:
        FmuFileError: the FMU is missing or broken, or states no sample time and gets none.
        InputError: a parameter doesn't exist or its value doesn't suit its type.
    """

    def __init__(
        self,
        path: str | Path,
        name: str = "fmu",
        parameters: Mapping[str, Value] | None = None,
        times: tuple[float, float] | None = None,
        feedthrough: Mapping[str, tuple[str, ...]] | None = None,
    ) -> None:
        self._equal_steps = times is not None
        times = open_fmu(Path(path)).sampling if times is None else times
        if times is None:
            raise FmuFileError(
                f"{path} doesn't tell its sample time; run it as a slave that is stepped, or give it one: "
                "fmu_slave(path, sample_time=1e-3)"
            )
        self.name = name
        self.sample_time, self.offset = times
        self._fmu = FmuSlave(path, name, parameters, input_order=0, output_order=0)
        self.path, self.parameters = self._fmu.path, self._fmu.parameters
        self.report, self.take_report = self._fmu.report, self._fmu.take_report
        self.variables, self.can_save = self._fmu.variables, self._fmu.can_save
        self.feedthrough = self._fmu.feedthrough if feedthrough is None else feedthrough
        # inputs wait here for the next instant
        self._inputs = np.array([i for i, each in enumerate(self.variables) if each.causality == "input"], np.intp)
        self._values = np.zeros(len(self.variables))
        self._send = nothing
        self._time: float | None = None

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Begin a run; inputs that were set before are the initial ones."""
        begin = start_time + self.offset if self._equal_steps else start_time
        self._fmu.initialize(begin, max(stop_time, begin + self.sample_time), tolerance)
        buffer = np.empty(self._inputs.size)
        self._fmu.get(self._inputs, buffer)
        self._values[self._inputs] = buffer
        self._time = begin
        self._send = self._sender()

    @property
    def messages(self) -> tuple[str, ...]:
        """What the FMU logged in the last run, warnings and worse."""
        return self._fmu.messages

    @property
    def remarks(self) -> tuple[str, ...]:
        """As of `FmuSlave`."""
        return self._fmu.remarks

    def _sender(self) -> Call:
        """A call that sets the FMU's inputs."""
        if not self._inputs.size:
            return nothing
        # from the values that wait, in the order of the inputs
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
            self._fmu.step(self._time, self.sample_time if self._equal_steps else time - self._time)
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

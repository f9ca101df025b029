"""FMUs as sampled slaves: stepped at their own sample instants only, inputs sampled, outputs held in between."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.engine.binding import Copy, Phase, Refresh, SampleCall, SampleStep, Take, nothing
from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.engine.errors import FmuFileError, InputError, SlaveError
from flexfmu.cosim.engine.fmu.file import UnpackedFmu, open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import Value
from flexfmu.cosim.engine.slave import Call, Indices, RealArray, check_sampling, feedthrough

PROBES = (1e-3, -1e-3, 1.0, -1.0)
"""Changes of all real inputs that reveal direct feedthrough; saturation may hide one sign, or large changes."""


def fmu_slave(
    path: str | Path,
    name: str = "fmu",
    parameters: Mapping[str, Value] | None = None,
    *,
    sample_time: float | None = None,
    offset: float = 0.0,
    output_order: int | None = None,
) -> SampledFmu | FmuTask | FmuSlave:
    """Return an FMU as a sampled or a stepped slave.

    An exported block states its own sample time. Another FMU is sampled if ``sample_time`` is set, or if it can't vary
    its communication step (canHandleVariableCommunicationStepSize = false) and states a step size (`fixed_step`).
    A sampled FMU either calculates its outputs before its step (`SampledFmu`): the outputs of a trial instance follow
    its inputs without a step, or no output depends on an input by the model description. Or it calculates them in
    fmi2DoStep (`FmuTask`).

    Args:
        path: the FMU file.
        name: name of the slave.
        parameters: start values of parameters and inputs by name.
        sample_time, offset: sample time and first sample instant after the start [s]; None for what the FMU states.
        output_order: highest output derivative to use, see `FmuSlave`; of no effect for a sampled FMU.

    Raises:
        FmuFileError: the FMU is missing or broken.
        InputError: a parameter doesn't exist or its value doesn't fit its type or range, a time is out of range or
            contradicts that of an exported block, or there is an offset without a sample time.
    """
    # an exported block: its own times
    fmu = open_fmu(Path(path))
    own = fmu.sampling
    if own is not None:
        if (sample_time or own[0], offset or own[1]) != own:
            raise InputError(
                f"{name}: {fmu.path} is a block with a sample time of {own[0]:g} s and an offset of {own[1]:g} s, which "
                f"can't be changed to {sample_time or own[0]:g} s and {offset:g} s; leave them out, or export the block anew"
            )
        return SampledFmu(path, name, parameters)
    # no sample time: a stepped slave
    chosen = fmu.fixed_step if sample_time is None else sample_time
    if chosen is None:
        if offset:
            raise InputError(f"{name}: an offset of {offset:g} s needs a sample time; add sample_time in s")
        return FmuSlave(path, name, parameters, output_order=output_order)
    # sampled: are outputs calculated before the step, or in it?
    check_sampling(chosen, offset, name)
    slave = FmuSlave(path, name, parameters, input_order=0, output_order=0)
    at_once = _tried(slave, fmu)
    declared = {output: names for output, names in feedthrough(slave).items() if names}
    if not at_once and declared:
        return FmuTask(slave, chosen, offset)
    # an output that follows inputs, although its description denies it, depends on all inputs
    honest = {output: names for output, names in slave.feedthrough.items() if names or output not in at_once}
    return SampledFmu(path, name, parameters, (chosen, offset), honest)


def _tried(slave: FmuSlave, fmu: UnpackedFmu) -> frozenset[str]:
    """Return what `_immediate` finds, for another tool's FMU in a child process; empty if the FMU crashes."""
    if not AVAILABLE or fmu.is_ours:
        return _immediate(slave)
    try:
        return frozenset(in_child(lambda: _immediate(slave), lambda: None, CALL_LIMIT))
    except ChildLostError:
        return frozenset()  # the run will report the error


def _immediate(slave: FmuSlave) -> frozenset[str]:
    """Return the outputs of a trial instance that follow real inputs without a step, as far as the FMU allows it."""
    variables = slave.variables
    inputs = np.array([i for i, v in enumerate(variables) if v.causality == "input" and not v.discrete], np.intp)
    outputs = np.array([i for i, v in enumerate(variables) if v.causality == "output"], np.intp)
    if not inputs.size or not outputs.size:
        return frozenset()
    before, after, start = np.empty(outputs.size), np.empty(outputs.size), np.empty(inputs.size)
    # different changes, since equal ones leave the differences between inputs unchanged
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


class _HeldFmu:
    """What both kinds of sampled FMUs have in common: the FMU's variables, reports and states; outputs held between samples.

    Args:
        slave: the FMU; nothing else may step it.
        sample_time, offset: sample time and first sample instant after the start [s].

    Attributes:
        path: the FMU file.
        parameters: start values by name.
        can_save: whether the FMU can save and restore its state.
    """

    def __init__(self, slave: FmuSlave, sample_time: float, offset: float) -> None:
        self._fmu = slave
        self.name, self.sample_time, self.offset = slave.name, sample_time, offset
        self.path, self.parameters, self.variables = slave.path, slave.parameters, slave.variables
        self.can_save, self.report, self.take_report = slave.can_save, slave.report, slave.take_report
        self.get, self.bind_get = slave.get, slave.bind_get

    @property
    def messages(self) -> tuple[str, ...]:
        """Messages of the FMU in the last run with status warning or worse."""
        return self._fmu.messages

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks as in `FmuSlave`."""
        return self._fmu.remarks

    def step(self, time: float, step: float) -> None:
        """Do nothing: between sample instants the outputs are held."""

    def release(self, state: tuple[Any, ...]) -> None:
        """Keep the memory of a saved state for the next one to be saved."""
        self._fmu.release(state[0])


class FmuTask(_HeldFmu):
    """A sampled FMU that calculates its outputs in fmi2DoStep, like a task of a digital controller.

    At t_k its inputs are set, it steps from t_k to t_k + sample_time, and its outputs are held from t_k on, as for a
    Python block y_k = f(x_k, u_k). It is initialised at its first sample instant; thus all steps have the same length.

    Args:
        slave: the FMU; nothing else may step it.
        sample_time, offset: sample time and first sample instant after the start [s].
    """

    feedthrough: Mapping[str, tuple[str, ...]] = {}

    def __init__(self, slave: FmuSlave, sample_time: float, offset: float = 0.0) -> None:
        super().__init__(slave, sample_time, offset)
        self.set, self.bind_set, self.terminate = slave.set, slave.bind_set, slave.terminate
        # first instant, sample time, number of steps
        self._steps = np.array([0.0, sample_time, 0.0])

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Initialise at the first sample instant; the FMU's stop time includes its steps beyond the end of the run."""
        first = start_time + self.offset
        self._steps[:] = first, self.sample_time, 0.0
        self._fmu.initialize(first, max(stop_time, first) + 2.0 * self.sample_time, tolerance)

    def sample(self, time: float) -> None:
        """Calculate outputs from the inputs just set, in a step to the next sample instant."""
        first, sample_time, count = self._steps.tolist()
        self._fmu.step(first + count * sample_time, sample_time)
        self._steps[2] += 1.0

    def sample_calls(self, phase: Phase) -> tuple[SampleCall, ...] | None:
        """The step of a sample; None if fmi2DoStep is more than one call."""
        bound = self._fmu.bound_step()
        return None if bound is None else (SampleStep(*bound, self._steps),)

    def save(self) -> tuple[Any, ...]:
        """Return the state of the FMU and the number of samples."""
        return self._fmu.save(), self._steps.copy()

    def restore(self, state: tuple[Any, ...]) -> None:
        """Restore a state returned by `save`."""
        self._fmu.restore(state[0])
        self._steps[:] = state[1]


class SampledFmu(_HeldFmu):
    """A sampled FMU that calculates its outputs before its step, an exported block for example.

    Sample instants, order of calls and results are those of the Python block. The FMU stays at its last sample instant
    and makes the step from there with the inputs of that instant; inputs set in between count at the next instant.

    Args:
        path: the FMU.
        name: name of the slave.
        parameters: start values of parameters and inputs by name.
        times: sample time and offset [s] of an FMU that isn't an exported block; it is initialised at its first sample
            instant, so that all steps have the same length. None for the times of an exported block.
        feedthrough: output → inputs that it depends on at the same instant; None for that of the model description.

    Raises:
        FmuFileError: the FMU is missing or broken, or has no sample time, neither stated nor in ``times``.
        InputError: a parameter doesn't exist or its value doesn't fit its type or range.
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
        super().__init__(FmuSlave(path, name, parameters, input_order=0, output_order=0), *times)
        self.feedthrough = self._fmu.feedthrough if feedthrough is None else feedthrough
        # inputs, stored until the next sample instant
        self._inputs = np.flatnonzero([each.causality == "input" for each in self.variables])
        self._values, self._sent = np.zeros(len(self.variables)), np.empty(self._inputs.size)
        self._take = Take(self._values, self._inputs, self._sent)
        self._send = self._fmu.bind_set(self._inputs, self._sent) if self._inputs.size else nothing
        self._refresh = Refresh(self._take, self._send)
        # time reached, and the step from there; 0 for a step to the next instant
        self._reached = np.array([0.0, self.sample_time if self._equal_steps else 0.0])
        self._initialized = False

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Initialise a run; inputs set before are the initial ones."""
        begin = start_time + self.offset if self._equal_steps else start_time
        self._fmu.initialize(begin, max(stop_time, begin + self.sample_time), tolerance)
        self._fmu.get(self._inputs, self._sent)
        self._values[self._inputs] = self._sent
        self._reached[0], self._initialized = begin, True

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs for the next sample instant."""
        self._values[indices] = values
        if not self._initialized:
            self._fmu.set(indices, values)

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        """Return a call that sets inputs from ``values`` (n,)."""
        return Copy(values, self._values, indices)

    def output(self, time: float) -> None:
        """Step to ``time`` [s] if it isn't reached yet, and set the inputs; may be repeated at the same instant."""
        if not self._initialized:
            return
        reached, step = self._reached.tolist()
        if time > reached:
            self._fmu.step(reached, step or time - reached)
            self._reached[0] = time
        self._take()
        self._send()

    def sample_calls(self, phase: Phase) -> tuple[SampleCall, ...] | None:
        """The step and the inputs of a sample; None if fmi2DoStep is more than one call."""
        if (bound := self._fmu.bound_step()) is None:
            return None
        if phase == "update":
            return (self._refresh,)
        inputs = (self._take, self._send) if self._inputs.size else ()
        return SampleStep(*bound, self._reached), *inputs

    def update(self, time: float) -> None:
        """Set the final inputs of the sample instant, with which the FMU makes its next step, if they have changed."""
        if self._initialized:
            self._refresh()

    def sample(self, time: float) -> None:
        """Step to ``time`` [s] and calculate outputs from the inputs just set."""
        self.output(time)

    def save(self) -> tuple[Any, ...]:
        """Return the state of the FMU, its time [s] and the stored inputs."""
        return self._fmu.save(), float(self._reached[0]), self._values.copy()

    def restore(self, state: tuple[Any, ...]) -> None:
        """Restore a state returned by `save`."""
        saved, self._reached[0], values = state
        self._fmu.restore(saved)
        self._sent.fill(np.nan)
        self._values[:] = values

    def terminate(self) -> None:
        """End the run and free the FMU's instance."""
        self._initialized = False
        self._fmu.terminate()

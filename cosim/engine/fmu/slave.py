"""An FMI 2.0 or 3.0 co-simulation FMU as a slave: loaded with fmpy, called on preallocated buffers."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.binding import nothing
from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, in_child
from flexfmu.cosim.engine.errors import CosimError, InputError, SlaveError
from flexfmu.cosim.engine.fmu.capabilities import (
    highest_input_derivative,
    highest_output_derivative,
    needs_regular_steps,
    only_once_per_process,
)
from flexfmu.cosim.engine.fmu.file import UnpackedFmu, open_fmu, resized
from flexfmu.cosim.engine.fmu.fmi3 import Fmi3Instance
from flexfmu.cosim.engine.fmu.fmi3_transfers import Fmi3Transfers
from flexfmu.cosim.engine.fmu.fmi3_variables import by_elements
from flexfmu.cosim.engine.fmu.instance import BoundStep, Checked, FmuInstance, FmuStates, Instance, load_calls
from flexfmu.cosim.engine.fmu.transfers import Statistics, Transfers
from flexfmu.cosim.engine.fmu.variables import (
    FmuVariables,
    Handle,
    Setting,
    Value,
    in_words,
    read_variables,
    same,
    settable_variables,
    settings,
)
from flexfmu.cosim.engine.slave import Call, Indices, RealArray

LISTED = 5
"""Names in a sentence; there may be hundreds."""


@dataclass(frozen=True)
class _Start:
    """A start value and the call that sets it."""

    setting: Setting
    set: Checked


class FmuSlave:
    """One instance of an FMU at a time; may run again and again, each time anew from its start values.

    Args:
        path: the FMU file.
        name: name of the slave.
        parameters: start values of parameters (and inputs) by name, in the FMU's units.
        input_order: highest input derivative to use where the FMU interpolates inputs; None for the highest that its
            model description states.
        output_order: highest output derivative to use, 0 for none; None for the highest that the model description states
            and the FMU really gives, output by output.

    Attributes:
        path: the FMU file.
        parameters: the start values that were given.
        statistics: Integer variables ``statistics.*`` at the end of the last run, without the prefix.
        can_save: whether the FMU can save and restore its state.
        needs_regular_steps: whether all of its communication steps must have the same length.
        messages: what the FMU logged in the last run, warnings and worse.
        remarks: what has been set before the last run and was another value after initialisation, a sentence each.
        lacking: output → lowest order of its derivatives that the FMU doesn't give from the start; it is never asked for.
        absent: output → lowest order of its derivatives that it didn't give in the last run, or that was no finite number;
            from there on they are taken as zero.

    Raises:
        FmuFileError: the FMU is missing or broken, of another kind, or has no binary for this platform.
        InputError: a parameter doesn't exist or its value doesn't suit its type or range.
    """

    def __init__(
        self,
        path: str | Path,
        name: str = "fmu",
        parameters: Mapping[str, Value] | None = None,
        input_order: int | None = None,
        output_order: int | None = None,
    ) -> None:
        self.name = name
        self.path = Path(path)
        self.parameters = self._given = dict(parameters or {})
        # variables, derivatives and capabilities by the model description
        self._fmu = resized(open_fmu(self.path), self._given)
        known = _variables(self._fmu)
        self.variables, self.feedthrough = known.connectable, known.feedthrough
        self._handles = known.handles
        self._stated_order = highest_output_derivative(self._fmu)
        if output_order is not None and not output_order >= 0:
            raise InputError(f"{name}: output_order must be zero or positive, got {output_order}")
        self.max_output_order = self._stated_order if output_order is None else min(output_order, self._stated_order)
        highest = highest_input_derivative(self._fmu)
        self.max_input_order = highest if input_order is None or highest == 0 else input_order
        self.can_save = bool(self._fmu.description.coSimulation.canGetAndSetFMUstate)
        self.needs_regular_steps = needs_regular_steps(self._fmu)
        # the instance that is in use, and calls that set start values
        self._instance, self._transfers = _interface(self._fmu)
        self._counters = Statistics(known.others, self._transfers.get)
        self._starts = self._given_starts = self._starting(self._given)
        self._presets: dict[int, float] = {}
        self._run: FmuStates | None = None
        self._free: Call = nothing
        # what a run leaves
        self.statistics: Mapping[str, int] = {}
        self.messages: tuple[str, ...] = ()
        self.remarks: tuple[str, ...] = ()
        self.lacking: Mapping[str, int] = {}
        self.absent: Mapping[str, int] = {}
        self._missing: list[NDArray[np.bool_]] = []
        if self.max_output_order and not self._fmu.is_ours:
            self._try_derivatives()

    def _try_derivatives(self) -> None:
        """Lower the orders of outputs whose derivatives a trial instance refuses, or gives as no finite numbers.

        Dymola and OpenModelica state one order and give NaN, always or right after initialisation. A trial that fails says
        nothing: the run will show.
        """
        real = [i for i, handle in enumerate(self._handles) if handle.kind == "Real"]
        outputs = [i for i in real if self.variables[i].causality == "output"]
        experiment = self._fmu.description.defaultExperiment
        start = float(getattr(experiment, "startTime", None) or 0.0)

        def tried() -> dict[str, int]:
            try:
                self.initialize(start, start + 1.0, None)
                return self._derivatives_not_given(outputs)
            finally:
                self.terminate()

        # in a child process, or here where the FMU may be instantiated again
        try:
            if AVAILABLE:
                self.lacking = self.absent = in_child(tried, lambda: None, CALL_LIMIT)
            elif not only_once_per_process(self._fmu):
                self.lacking = self.absent = tried()
        except CosimError:
            return
        orders = (self.lacking.get(self.variables[i].name, self.max_output_order + 1) - 1 for i in outputs)
        self.max_output_order = max(orders, default=0)

    def _derivatives_not_given(self, outputs: Sequence[int]) -> dict[str, int]:
        """Output → lowest order of its derivatives that isn't there now, for outputs that lack any."""
        shape = self.max_output_order, len(outputs)
        found = np.full(shape, np.nan)
        handles = [self._handles[index] for index in outputs]
        if not self._instance.accepts(self._transfers.get_derivatives(handles, found)):
            # asked one by one, it shows which
            for column, handle in enumerate(handles):
                one = np.full((shape[0], 1), np.nan)
                accepted = self._instance.accepts(self._transfers.get_derivatives([handle], one))
                found[:, column] = one[:, 0] if accepted else np.nan
        absent = ~np.isfinite(found)
        return {
            self.variables[index].name: 1 + int(absent[:, column].argmax())
            for column, index in enumerate(outputs)
            if absent[:, column].any()
        }

    def vary(self, changes: Mapping[str, Value]) -> None:
        """Start values of parameters and inputs for the runs to come; all others are those that the slave was made with.

        Raises:
            InputError: a parameter doesn't exist or its value doesn't suit its type or range, or it is a structural one.
        """
        if resized(self._fmu, {**self._given, **changes}).sizes != self._fmu.sizes:
            raise InputError(
                f"{self.name}: structural parameters can't vary from run to run; make a slave for each of them"
            )
        self._starts = {**self._given_starts, **self._starting(changes)}
        self.parameters = {**self._given, **changes}

    def _starting(self, parameters: Mapping[str, Value]) -> dict[str, _Start]:
        """Name → start value and the call that sets it."""
        transfers, checked = self._transfers, self._instance.checked
        return {
            each.name: _Start(each, checked(f"setting {each.name} = {each.value}", transfers.setting(each)))
            for each in settings(_settable(self._fmu), by_elements(self._fmu.description, parameters))
        }

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Instantiate, set parameters and inputs, and go through initialisation mode.

        An FMU of another tool may forget what it is given before initialisation mode and is given it again there. What
        has been set is read back afterwards; `remarks` says what differs.

        Raises:
            SlaveError: the FMU refuses, with its own sentence.
        """
        self.terminate()
        self.remarks, self.absent = (), dict(self.lacking)
        for missing in self._missing:
            missing.fill(False)
        # a new instance; freed at the latest with the slave
        instance = self._instance
        instance.instantiate(self.name)
        self._run = run = FmuStates(instance)
        self._free = weakref.finalize(self, run.free)
        instance.set_up(start_time, stop_time, tolerance)
        # start values and inputs before initialisation mode
        for start in self._starts.values():
            start.set()
        handles = [self._handles[index] for index in self._presets]
        presets = self._transfers.set(handles, np.array([*self._presets.values()]))
        instance.check("setting inputs", presets)

        # and again in it, for FMUs of other tools that have forgotten them
        def repeat() -> None:
            if self._fmu.is_ours:
                return
            for start in self._starts.values():
                found = self._read_back(start.setting)
                if start.setting.lasting and (found is None or not same(start.setting.value, found)):
                    instance.accepts(start.set.call)
            instance.check("setting inputs", presets)

        instance.initialize(repeat)
        self.remarks = tuple(self._differences())

    def _differences(self) -> Iterator[str]:
        """What isn't as it was set; inputs that others have set since are left out, and what can't be read."""
        # inputs that other slaves have set since don't count
        preset = {self.variables[index].name for index in self._presets}
        for name, start in self._starts.items():
            value, found = start.setting.value, self._read_back(start.setting)
            if start.setting.lasting and name not in preset and found is not None and not same(value, found):
                variable = _settable(self._fmu)[name]
                yield (
                    f"{name} was set to {in_words(variable, value)}, but is {in_words(variable, found)} after initialisation: "
                    f"{self.path.name} ignores it or calculates it"
                )

    def _read_back(self, setting: Setting) -> Value | None:
        """The present value of what was set; None where the FMU doesn't give it."""
        call, value = self._transfers.reading(setting)
        return value() if self._instance.accepts(call) else None

    def step(self, time: float, step: float) -> None:
        """Let the FMU advance.

        Raises:
            SlaveError: the FMU fails or gets through only a part of the step; carries the last time that it reached.
        """
        self._instance.step(time, step, self._running().no_rollback)

    def bound_step(self) -> BoundStep | None:
        """fmi2DoStep with its component bound, and what makes the error of a failed step; None where there is more to do."""
        return self._instance.bound_step()

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs; before initialisation they are kept for it."""
        if self._run is None:
            self._presets.update(zip(indices.tolist(), values.tolist(), strict=True))
        else:
            self.bind_set(indices, np.ascontiguousarray(values))()

    def get(self, indices: Indices, values: RealArray) -> None:
        """Read variables."""
        self._running()
        buffer = np.empty(values.shape)
        self.bind_get(indices, buffer)()
        values[:] = buffer

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Set derivatives of inputs."""
        self._running()
        self.bind_set_derivatives(indices, np.ascontiguousarray(derivatives))()

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Read derivatives of outputs."""
        self._running()
        buffer = np.empty(derivatives.shape)
        self.bind_get_derivatives(indices, buffer)()
        derivatives[:] = buffer

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        """A call that sets inputs from the buffer."""
        return self._instance.checked("setting inputs", self._transfers.set(self._select(indices), values))

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        """A call that reads variables into the buffer."""
        return self._instance.checked("reading variables", self._transfers.get(self._select(indices), values))

    def bind_set_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """A call that sets derivatives of inputs from the buffer."""
        call = self._transfers.set_derivatives(self._select(indices), derivatives)
        return self._instance.checked("setting input derivatives", call)

    def bind_get_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """A call that reads derivatives of outputs into the buffer."""
        handles, what = self._select(indices), "reading output derivatives"
        if self._fmu.is_ours:
            return self._instance.checked(what, self._transfers.get_derivatives(handles, derivatives))
        orders = np.arange(1, len(derivatives) + 1)[:, None]
        lowest = [self.lacking.get(self.variables[index].name, len(derivatives) + 1) for index in indices]
        call = self._transfers.get_derivatives(handles, derivatives, orders >= np.array(lowest))
        return self._tidied(self._instance.checked(what, call), indices, derivatives)

    def _tidied(self, read: Call, indices: Indices, derivatives: RealArray) -> Call:
        """The call, with zeros for derivatives that have been no finite numbers, and for those above them."""
        missing = np.zeros(derivatives.shape, dtype=np.bool_)
        self._missing.append(missing)

        def tidy() -> None:
            read()
            # once missing an order stays so for the run, and those above it
            finite = np.isfinite(derivatives)
            if not finite.all():
                missing[:] |= np.logical_or.accumulate(~finite, axis=0)
                columns = np.flatnonzero(missing.any(axis=0))
                lowest = {self.variables[indices[k]].name: 1 + int(missing[:, k].argmax()) for k in columns}
                self.absent = {**self.absent, **lowest}
            derivatives[missing] = 0.0

        return tidy

    def absence(self, outputs: Sequence[str]) -> list[str]:
        """A sentence about the derivatives of these outputs that were absent in the last run, if there are any."""
        if not outputs:
            return []
        listed = ", ".join(f"der({name},{self.absent[name]})" for name in outputs[:LISTED])
        more = f" and {len(outputs) - LISTED} more" if len(outputs) > LISTED else ""
        return [
            f"{self.path.name} states maxOutputDerivativeOrder = {self._stated_order}, but doesn't give finite numbers for "
            f"{listed}{more}; output derivatives from these orders on are left out (output_order = 0 asks for none)"
        ]

    def report(self) -> Mapping[str, Any]:
        """What there is to say about the last run, for `take_report` in another process."""
        return {name: vars(self)[name] for name in ("statistics", "messages", "remarks", "absent")}

    def take_report(self, report: Mapping[str, Any]) -> None:
        """Take over what was reported in another process."""
        vars(self).update(report)

    def save(self) -> object:
        """The FMU's complete state; valid until it is released, or until `terminate`.

        Raises:
            SlaveError: the FMU can't save its state.
        """
        return self._running().save()

    def restore(self, state: object) -> None:
        """Go back to a saved state."""
        self._running().restore(state)

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one."""
        if self._run is not None:
            self._run.release(state)

    def terminate(self) -> None:
        """Read the statistics, then terminate and free the instance; nothing to do without one."""
        if self._run is not None:
            self._run = None
            self.statistics = self._counters.read() if self._instance.initialized else {}
            self._free()
            self.messages = tuple(self._instance.log.messages)

    def _select(self, indices: Indices) -> list[Handle]:
        """Handles of variables."""
        return [self._handles[index] for index in indices]

    def _running(self) -> FmuStates:
        """The present run.

        Raises:
            SlaveError: there is none.
        """
        if self._run is None:
            raise SlaveError(self.name, "not initialised; call initialize first")
        return self._run


def _interface(fmu: UnpackedFmu) -> tuple[Instance, Transfers | Fmi3Transfers]:
    """What reaches instances of the FMU and their variables."""
    fmi = load_calls(fmu)
    if fmu.is_fmi3:
        newer = Fmi3Instance(fmu, fmi)
        return newer, Fmi3Transfers(newer)
    instance = FmuInstance(fmu, fmi)
    return instance, Transfers(fmi, instance.component)


@cache
def _variables(fmu: UnpackedFmu) -> FmuVariables:
    """What the FMU's model description says about variables, read once."""
    return read_variables(fmu.description)


@cache
def _settable(fmu: UnpackedFmu) -> Mapping[str, Any]:
    """The FMU's variables that may be given start values, read once."""
    return settable_variables(fmu.description)

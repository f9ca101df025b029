"""An FMI 2.0 co-simulation FMU as a slave: loaded with fmpy, called on preallocated buffers."""

from __future__ import annotations

import warnings
import weakref
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.errors import CosimError, SlaveError, SlaveWarning
from flexfmu.cosim.fmu import calls as fmi2
from flexfmu.cosim.fmu.capabilities import highest_input_derivative, highest_output_derivative, needs_regular_steps
from flexfmu.cosim.fmu.file import UnpackedFmu, open_fmu
from flexfmu.cosim.fmu.instance import FmuInstance, load_calls
from flexfmu.cosim.fmu.run import FmuRun
from flexfmu.cosim.fmu.statistics import Statistics
from flexfmu.cosim.fmu.transfers import Transfers
from flexfmu.cosim.fmu.variables import FmuVariables, Handle, Value, read_variables, settable_variables, settings
from flexfmu.cosim.master.binding import nothing
from flexfmu.cosim.master.isolation import AVAILABLE, CALL_LIMIT, in_child
from flexfmu.cosim.slave import Call, Indices, RealArray


class FmuSlave:
    """One instance of an FMU at a time; may run again and again, each time anew from its start values.

    Args:
        path: the FMU file.
        name: name of the slave.
        parameters: start values of parameters (and inputs) by name, in the FMU's units.
        input_order: highest input derivative to use where the FMU interpolates inputs; None for the highest that its
            model description states.
        output_order: highest output derivative to use, 0 for none; None for the highest that the model description states
            and the FMU really gives.

    Attributes:
        path: the FMU file.
        parameters: the start values that were given.
        statistics: Integer variables ``statistics.*`` at the end of the last run, without the prefix.
        can_save: whether the FMU can save and restore its state.
        needs_regular_steps: whether all of its communication steps must have the same length.
        messages: what the FMU logged in the last run, warnings and worse.
        absent: output → lowest order of its derivatives that was no finite number in the last run; from there on it was
            taken as zero.

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
        self._fmu = open_fmu(self.path)
        known = _variables(self._fmu)
        self.variables, self.feedthrough = known.connectable, known.feedthrough
        self._handles = known.handles
        stated = highest_output_derivative(self._fmu)
        self.max_output_order = stated if output_order is None else min(output_order, stated)
        highest = highest_input_derivative(self._fmu)
        self.max_input_order = highest if input_order is None or highest == 0 else input_order
        self.can_save = bool(self._fmu.description.coSimulation.canGetAndSetFMUstate)
        fmi = load_calls(self._fmu)
        self.needs_regular_steps = needs_regular_steps(self._fmu)
        self._instance = FmuInstance(self._fmu, fmi)
        self._transfers = Transfers(fmi, self._instance.component)
        self._do_step: partial[int] = partial(fmi["fmi2DoStep"], self._instance.component)
        self._counters = Statistics(known.others, self._transfers)
        self._starts = self._given_starts = self._starting(self._given)
        self._presets: dict[int, float] = {}
        self._run: FmuRun | None = None
        self._free: Call = nothing
        self.statistics: Mapping[str, int] = {}
        self.messages: tuple[str, ...] = ()
        self.absent: dict[str, int] = {}
        self._missing: list[NDArray[np.bool_]] = []
        if self.max_output_order and not self._fmu.is_ours:
            self.max_output_order = self._order_given()

    def _order_given(self) -> int:
        """Highest derivative that is a finite number for all outputs right after initialisation, as a trial instance shows.

        Dymola and OpenModelica state one order and give NaN. A trial that fails says nothing: the run will tell.
        """
        real = [i for i, each in enumerate(self.variables) if each.causality == "output" and not each.discrete]
        experiment = self._fmu.description.defaultExperiment
        start = float(getattr(experiment, "startTime", None) or 0.0)

        def tried() -> int:
            found = np.zeros((self.max_output_order, len(real)))
            self.initialize(start, start + 1.0, None)
            try:
                self.bind_get_derivatives(np.array(real, np.intp), found)()
            finally:
                self.terminate()
            return min(self.absent.values(), default=self.max_output_order + 1) - 1

        try:
            order = int(in_child(tried, lambda: None, CALL_LIMIT)) if AVAILABLE else tried()
        except CosimError:
            return self.max_output_order
        finally:
            self._missing.clear()
        if order < self.max_output_order:
            warnings.warn(
                f"{self.name}: {self.path.name} states maxOutputDerivativeOrder = {self.max_output_order}, but after its "
                f"initialisation derivatives of order {order + 1} are no finite numbers; they are left out",
                SlaveWarning,
                stacklevel=3,
            )
        return order

    def vary(self, changes: Mapping[str, Value]) -> None:
        """Start values of parameters and inputs for the runs to come; all others are those that the slave was made with.

        Raises:
            InputError: a parameter doesn't exist or its value doesn't suit its type or range.
        """
        self._starts = {**self._given_starts, **self._starting(changes)}
        self.parameters = {**self._given, **changes}

    def _starting(self, parameters: Mapping[str, Value]) -> dict[str, Call]:
        """Name → call that sets it."""
        return {
            each.name: self._instance.checked(f"setting {each.name} = {each.value}", self._transfers.setting(each))
            for each in settings(_settable(self._fmu), parameters)
        }

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Instantiate, set parameters and inputs, and go through initialisation mode.

        Raises:
            SlaveError: the FMU refuses, with its own sentence.
        """
        self.terminate()
        self.absent = {}
        for missing in self._missing:
            missing.fill(False)
        instance, transfers = self._instance, self._transfers
        instance.instantiate(self.name)
        self._run = run = FmuRun(instance)
        self._free = weakref.finalize(self, run.free)
        for start in self._starts.values():
            start()
        handles = [self._handles[index] for index in self._presets]
        if handles:
            instance.check("setting inputs", transfers.set(handles, np.array([*self._presets.values()])))
        instance.initialize(start_time, stop_time, tolerance)

    def step(self, time: float, step: float) -> None:
        """Let the FMU advance.

        Raises:
            SlaveError: the FMU fails or gets through only a part of the step; carries the last time that it reached.
        """
        run = self._running()
        if (status := self._do_step(time, step, run.no_rollback)) > fmi2.WARNING:
            raise run.step_error(status, time, step)

    def bound_step(self) -> tuple[partial[int], Callable[[int, float, float], BaseException]]:
        """fmi2DoStep with its component bound, and what makes the error of a failed step."""
        return self._do_step, lambda status, time, step: self._running().step_error(status, time, step)

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
        call = self._transfers.get_derivatives(self._select(indices), derivatives)
        read = self._instance.checked("reading output derivatives", call)
        return read if self._fmu.is_ours else self._tidied(read, indices, derivatives)

    def _tidied(self, read: Call, indices: Indices, derivatives: RealArray) -> Call:
        """The call, with zeros for derivatives that have been no finite numbers, and for those above them."""
        missing = np.zeros(derivatives.shape, dtype=np.bool_)
        self._missing.append(missing)

        def tidy() -> None:
            read()
            finite = np.isfinite(derivatives)
            if not finite.all():
                missing[:] |= np.logical_or.accumulate(~finite, axis=0)
                for column in np.flatnonzero(missing.any(axis=0)):
                    self.absent[self.variables[indices[column]].name] = int(missing[:, column].argmax()) + 1
            if self.absent:
                derivatives[missing] = 0.0

        return tidy

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

    def _running(self) -> FmuRun:
        """The present run.

        Raises:
            SlaveError: there is none.
        """
        if self._run is None:
            raise SlaveError(self.name, "not initialised; call initialize first")
        return self._run


@cache
def _variables(fmu: UnpackedFmu) -> FmuVariables:
    """What the FMU's model description says about variables, read once."""
    return read_variables(fmu.description)


@cache
def _settable(fmu: UnpackedFmu) -> Mapping[str, Any]:
    """The FMU's variables that may be given start values, read once."""
    return settable_variables(fmu.description)

"""An FMI 2.0 or 3.0 FMU as a slave, for co-simulation or model exchange: loaded with fmpy, called on preallocated buffers.

A trial instance shows which of its stated output derivatives an FMU of another tool provides.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.binding import nothing
from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, in_child
from flexfmu.cosim.engine.errors import CosimError, InputError, SlaveError
from flexfmu.cosim.engine.fmu.calls import WARNING, address, value_references
from flexfmu.cosim.engine.fmu.clocks import Clocks
from flexfmu.cosim.engine.fmu.file import EXCHANGE_ORDER, KEPT, UnpackedFmu, open_fmu, resized
from flexfmu.cosim.engine.fmu.instance import BoundStep, Checked, Fmi2Instance, Fmi3Instance, Instance, StatusCall
from flexfmu.cosim.engine.fmu.transfers import StartValues, Transfers
from flexfmu.cosim.engine.fmu.variables import COUNTERS, FmuVariables, Handle, Value, read_variables
from flexfmu.cosim.engine.slave import Call, Indices, RealArray

LISTED = 5
"""Largest number of names in a sentence; there may be hundreds."""


class FmuSlave:
    """An FMU as a slave: one instance at a time, each run with a new instance and from the start values.

    Args:
        path: the FMU file.
        name: name of the slave.
        parameters: start values of parameters (and inputs) by name, in the FMU's units.
        input_order: highest input derivative to use if the FMU interpolates inputs; None for the highest that its
            model description states.
        output_order: highest output derivative to use, 0 for none; None for the highest that the model description
            states and the FMU provides, output by output.

    Attributes:
        path: the FMU file.
        parameters: start values by name.
        statistics: Integer variables ``statistics.*`` at the end of the last run; names without the prefix.
        can_save: whether the FMU can save and restore its state.
        needs_regular_steps: whether all of its communication steps must have the same length.
        messages: messages of the FMU in the last run with status warning or worse.
        remarks: start values that differed after the last initialisation, one sentence each.
        lacking: output → lowest order of its derivatives that the trial instance didn't provide; such derivatives are
            never read.
        absent: output → lowest order of its derivatives that was lacking or not finite in the last run; derivatives of
            this order and above count as zero.

    Raises:
        FmuFileError: the FMU is missing or broken, of another kind, or has no binary for this platform.
        InputError: a parameter doesn't exist, its value doesn't fit its type or range, or output_order is negative.
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
        # variables, orders of derivatives and capabilities from the model description
        self._fmu = resized(open_fmu(self.path), self._given)
        known = _variables(self._fmu)
        self.variables, self.feedthrough = known.connectable, known.feedthrough
        self._handles = known.handles
        # an FMU with clocks gives no derivatives at their ticks
        stated = getattr(self._fmu.interface, "maxOutputDerivativeOrder", 0) or 0
        stated_order = 0 if self._fmu.clocks else int(stated)
        if output_order is not None and not output_order >= 0:
            raise InputError(f"{name}: output_order must be zero or positive, got {output_order}")
        # in model exchange the derivatives of states are variables themselves, and where they are states, theirs
        self._rates: list[list[Handle]] = []
        for handle in known.handles if self._fmu.is_exchange else ():
            rate, chain = known.rates.get((handle.reference, handle.place)), list[Handle]()
            while rate is not None and handle.kind == "Real" and len(chain) < EXCHANGE_ORDER:
                chain.append(rate)
                rate = known.rates.get((rate.reference, rate.place))
            self._rates.append(chain)
        stated_order = max(map(len, self._rates), default=stated_order)
        self.max_output_order = stated_order if output_order is None else min(output_order, stated_order)
        highest = self._fmu.highest_input_derivative
        self.max_input_order = highest if input_order is None or highest == 0 else input_order
        self.can_save = bool(self._fmu.interface.canGetAndSetFMUstate)
        self.needs_regular_steps = self._fmu.needs_regular_steps
        # the instance, transfers of its variables, and calls that set start values
        self._instance: Instance = (Fmi3Instance if self._fmu.is_fmi3 else Fmi2Instance)(self._fmu)
        self._transfers = Transfers(self._instance)
        self._instance.clocks = Clocks(self._instance, self._fmu.clocks, self._transfers, self.variables, self._handles)
        counters = {n: each for n, each in known.others.items() if n.startswith(COUNTERS) and each.kind == "Integer"}
        self._counters, self._counts = [name.removeprefix(COUNTERS) for name in counters], np.zeros(len(counters))
        self._count = self._transfers.get([*counters.values()], self._counts)
        self._starts = StartValues(self._fmu, self._instance, self._transfers, self._given)
        self._presets: dict[int, float] = {}
        self._preset: tuple[list[int], RealArray, StatusCall] | None = None
        self._running = False
        self._free: Call = nothing
        # results of a run
        self.statistics: Mapping[str, int] = {}
        self.messages: tuple[str, ...] = ()
        self.remarks: tuple[str, ...] = ()
        self.lacking: Mapping[str, int] = {}
        self.absent: Mapping[str, int] = {}
        self._missing: list[NDArray[np.bool_]] = []
        if self._rates:
            numbers = zip(self.variables, map(len, self._rates), strict=True)
            outputs = ((v.name, n) for v, n in numbers if v.causality == "output" and not v.discrete)
            self.lacking = self.absent = {name: n + 1 for name, n in outputs if n < self.max_output_order}
        elif self.max_output_order and not self._fmu.is_ours:
            self._try_derivatives()

    @property
    def start_numbers(self) -> Mapping[str, float]:
        """Start values that the next run sets, as numbers."""
        return self._starts.numbers

    @property
    def rates_follow_inputs(self) -> bool:
        """Whether outputs stay continuous when inputs jump, while their derivatives jump: in model exchange they are those of states."""
        return self._fmu.is_exchange

    def _try_derivatives(self) -> None:
        """Lower the orders of output derivatives to those that a trial instance provides as finite numbers.

        FMUs of Dymola and OpenModelica state an order but return NaN, always or right after initialisation. If the trial
        fails, the stated orders stay.
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

        # in a child process, or else here if the FMU can be instantiated again
        try:
            if AVAILABLE:
                self.lacking = self.absent = in_child(tried, lambda: None, CALL_LIMIT)
            elif not self._fmu.only_once_per_process:
                self.lacking = self.absent = tried()
        except CosimError:
            return
        # the highest order that any output provides
        orders = (self.lacking.get(self.variables[i].name, self.max_output_order + 1) - 1 for i in outputs)
        self.max_output_order = max(orders, default=0)

    def _derivatives_not_given(self, outputs: Sequence[int]) -> dict[str, int]:
        """Return output → lowest order of its derivatives that isn't available now, for outputs that lack any."""
        shape = self.max_output_order, len(outputs)
        found = np.full(shape, np.nan)
        handles = [self._handles[index] for index in outputs]
        if not self._instance.accepts(self._transfers.get_derivatives(handles, found)):
            # read each output by itself to find which fail
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
        """Change start values of parameters and inputs for the next runs; all others are those of the constructor.

        Raises:
            InputError: a parameter doesn't exist or is structural, or its value doesn't fit its type or range.
        """
        if not changes and self.parameters == self._given:
            return
        if resized(self._fmu, {**self._given, **changes}).sizes != self._fmu.sizes:
            raise InputError(
                f"{self.name}: structural parameters can't vary from run to run; make a slave for each of them"
            )
        self._starts.vary(changes)
        self.parameters = {**self._given, **changes}

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Instantiate, set parameters and inputs, and go through initialisation mode.

        FMUs of other tools may lose values set before initialisation mode; these are set again in that mode. Start
        values are read back afterwards; `remarks` lists those that differ.

        Raises:
            SlaveError: the FMU refuses, with its message.
        """
        self.terminate()
        self.remarks, self.absent = (), dict(self.lacking)
        for missing in self._missing:
            missing.fill(False)
        # a new instance, freed with the slave at the latest
        instance = self._instance
        instance.instantiate(self.name)
        self._running, self._free = True, weakref.finalize(self, instance.free)
        instance.set_up(start_time, stop_time, tolerance)
        # start values and inputs before initialisation mode
        self._starts.set()
        presets = self._set_presets()
        instance.check("setting inputs", presets)

        # and again in initialisation mode, for FMUs of other tools that have lost them
        def repeat() -> None:
            if not self._fmu.is_ours:
                self._starts.set_lost()
                instance.check("setting inputs", presets)

        instance.initialize(repeat)
        # inputs that the master has set may differ
        preset = {self.variables[index].name for index in self._presets}
        self.remarks = tuple(each for name, each in self._starts.differences() if name not in preset)

    def _set_presets(self) -> StatusCall:
        """Return the call that sets the inputs stored for initialisation; runs of one system have the same ones."""
        if self._preset is None or self._preset[0] != [*self._presets]:
            values = np.empty(len(self._presets))
            handles = [self._handles[index] for index in self._presets]
            self._preset = [*self._presets], values, self._transfers.set(handles, values)
        _, values, call = self._preset
        values[:] = [*self._presets.values()]
        return call

    def step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s].

        Raises:
            SlaveError: the FMU fails or completes only part of the step; its ``time`` is the last time reached.
            SlaveEnded: the FMU requests the end of the simulation.
        """
        self._check_running()
        self._instance.step(time, step)

    def bound_step(self) -> BoundStep | None:
        """Return fmi2DoStep bound to the component and a function for the error; None if `step` does more."""
        return self._instance.bound_step()

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs; before initialisation the values are stored for it."""
        if not self._running:
            self._presets.update(zip(indices.tolist(), values.tolist(), strict=True))
        else:
            self._transferred(self.bind_set, indices, values)

    def get(self, indices: Indices, values: RealArray) -> None:
        """Read variables."""
        values[:] = self._transferred(self.bind_get, indices, values)

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Set derivatives of inputs."""
        self._transferred(self.bind_set_derivatives, indices, derivatives)

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Read derivatives of outputs."""
        derivatives[:] = self._transferred(self.bind_get_derivatives, indices, derivatives)

    def _transferred(
        self, bind: Callable[[Indices, RealArray], Call], indices: Indices, values: RealArray
    ) -> RealArray:
        """Make a transfer once with a contiguous copy of the buffer, and return that."""
        self._check_running()
        buffer = np.array(values, order="C")
        bind(indices, buffer)()
        return buffer

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        """Return a call that sets inputs from the buffer (n,)."""
        return Checked(self._instance, "setting inputs", self._transfers.set(self._select(indices), values))

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        """Return a call that reads variables into the buffer (n,)."""
        return Checked(self._instance, "reading variables", self._transfers.get(self._select(indices), values))

    def bind_set_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """Return a call that sets derivatives of inputs from the buffer (orders, n)."""
        call = self._transfers.set_derivatives(self._select(indices), derivatives)
        return Checked(self._instance, "setting input derivatives", call)

    def bind_get_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """Return a call that reads derivatives of outputs into the buffer (orders, n); absent ones are zero."""
        handles, what = self._select(indices), "reading output derivatives"
        if self._rates:
            rows = [[row for row in range(len(derivatives)) if row < len(self._rates[i])] for i in indices]
            places = [(row, column) for column, each in enumerate(rows) for row in each]
            rates = [self._rates[indices[column]][row] for row, column in places]
            return Checked(self._instance, what, self._transfers.get_at(rates, derivatives, places))
        if self._fmu.is_ours:
            return Checked(self._instance, what, self._transfers.get_derivatives(handles, derivatives))
        # FMUs of other tools: don't read what the trial instance lacked
        orders = np.arange(1, len(derivatives) + 1)[:, None]
        lowest = [self.lacking.get(self.variables[index].name, len(derivatives) + 1) for index in indices]
        call = self._transfers.get_derivatives(handles, derivatives, orders >= np.array(lowest))
        return self._tidied(Checked(self._instance, what, call), indices, derivatives)

    def directional_derivatives(self, unknowns: Indices, knowns: Indices) -> RealArray:
        """Return the partial derivatives (n, m) of n real outputs with respect to m real states or inputs, at this instant.

        Raises:
            SlaveError: the FMU, one of FMI 2.0, doesn't give them.
        """
        references, known = (
            value_references([handle.reference for handle in self._select(each)]) for each in (unknowns, knowns)
        )
        found, seed, instance = np.empty((len(known), len(references))), np.ones(1), self._instance
        for row, each in zip(found, known, strict=True):
            one = np.array([each])
            arguments = address(references), len(references), address(one), 1, address(seed), address(row)
            instance.must("reading directional derivatives", "GetDirectionalDerivative", *arguments)
        return found.T

    def _tidied(self, read: Call, indices: Indices, derivatives: RealArray) -> Call:
        """Return the call with zeros for derivatives that weren't finite before in the run, and for higher orders."""
        missing = np.zeros(derivatives.shape, dtype=np.bool_)
        self._missing.append(missing)

        def tidy() -> None:
            read()
            # an order that was missing once stays missing for the run, with all higher ones
            finite = np.isfinite(derivatives)
            if not finite.all():
                missing[:] |= np.logical_or.accumulate(~finite, axis=0)
                columns = np.flatnonzero(missing.any(axis=0))
                lowest = {self.variables[indices[k]].name: 1 + int(missing[:, k].argmax()) for k in columns}
                self.absent = {**self.absent, **lowest}
            derivatives[missing] = 0.0

        return tidy

    def absence(self, outputs: Sequence[str]) -> list[str]:
        """Return a sentence on the absent derivatives of these outputs in the last run, none without outputs and in model exchange."""
        if not outputs or self._rates:
            return []
        listed = ", ".join(f"der({name},{self.absent[name]})" for name in outputs[:LISTED])
        more = f" and {len(outputs) - LISTED} more" if len(outputs) > LISTED else ""
        return [
            f"{self.path.name} states maxOutputDerivativeOrder = {self._fmu.interface.maxOutputDerivativeOrder}, but doesn't give finite numbers for "
            f"{listed}{more}; output derivatives from these orders on are left out (output_order = 0 asks for none)"
        ]

    def report(self) -> Mapping[str, Any]:
        """Return statistics, messages, remarks and absent derivatives of the last run, for `take_report`."""
        return {name: vars(self)[name] for name in ("statistics", "messages", "remarks", "absent")}

    def take_report(self, report: Mapping[str, Any]) -> None:
        """Take over the report of a run in another process."""
        vars(self).update(report)

    def save(self) -> object:
        """Return the FMU's complete state; valid until it is released, or until `terminate`.

        Raises:
            SlaveError: the FMU can't save its state.
        """
        self._check_running()
        return self._instance.save()

    def restore(self, state: object) -> None:
        """Restore a saved state."""
        self._check_running()
        self._instance.restore(state)

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one to be saved."""
        if self._running:
            self._instance.release(state)

    def terminate(self) -> None:
        """Read the statistics, then terminate and free the instance; without one, do nothing."""
        if self._running:
            self._running = False
            known = self._counters and self._instance.initialized and self._count() <= WARNING
            self.statistics = dict(zip(self._counters, map(int, self._counts), strict=True)) if known else {}
            self._free()
            self.messages = tuple(self._instance.log.messages)

    def _select(self, indices: Indices) -> list[Handle]:
        """Return the handles of variables."""
        return [self._handles[index] for index in indices]

    def _check_running(self) -> None:
        """Raise `SlaveError` if the slave isn't initialised."""
        if not self._running:
            raise SlaveError(self.name, "not initialised; call initialize first")


@lru_cache(maxsize=KEPT)
def _variables(fmu: UnpackedFmu) -> FmuVariables:
    """Return the variables of the FMU's model description, read once."""
    return read_variables(fmu.description)

"""Model exchange: integrates the states of an FMU between communication points, and finds its events.

The method is Radau IIA of order 5, in C (``c-master/exchange.c``): implicit and L-stable, for stiff and other FMUs alike, and of one
step, so that a jump of the inputs at a communication point costs no start of low order. Its matrices are kept from one
communication step to the next.

A step in which an event indicator changes its domain, z > 0 or z <= 0 (FMI 2.0.4, section 3.1.1), is made once more up to the
first such change: found on the polynomial of the step, and again until step and polynomial end there. The states at
an event are then those of a whole step, not of its interpolation.
"""

from __future__ import annotations

from ctypes import addressof, byref, c_size_t, c_void_p, cast, memmove, sizeof
from math import ulp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import SlaveError
from flexfmu.cosim.engine.fmu import calls as fmi
from flexfmu.cosim.engine.fmu.calls import address, value_references
from flexfmu.cosim.engine.shared_library import c_structures, shared_library
from flexfmu.cosim.engine.slave import RealArray

NEAR = 1e-9
"""Instants closer than this fraction of the communication step count as one: FMUs sum up their own times."""

MOST_ROUNDS = 1000
"""Limit of the iterations of one event, and of successive events without progress in time."""

TOLERANCE, ABSOLUTE = 1e-6, 0.01
"""Relative tolerance where none is given, and absolute tolerance relative to it and to a state's nominal value (FMI 2.0.4,
section 2.1.5: fmi2SetupExperiment)."""

LEAST_TOLERANCE = 1e-12
"""Least relative tolerance: below it, rounding decides in the FMU's derivatives."""

LEAST_STEP = 1e-13
"""Shortest step after one that the FMU discards, relative to the communication step."""

_REACHED, _EVENT, _ENDS, _STUCK, _FAILED = range(5)
"""What ``master_exchange_advance`` returns."""


_Record, _Polynomials, _Exchange = (
    c_structures("master")[f"master_exchange{part}"] for part in ("_record", "_polynomials", "")
)


class ContinuousTime:
    """Integrates the continuous states of an instance for model exchange.

    Args:
        instance: the `Instance`; its events are handled by `Instance.at_event`, which ends with `go_on`.
        fmu: its FMU.

    Raises:
        BuildError: the integrator can't be compiled, for example without a C compiler.
    """

    def __init__(self, instance: Any, fmu: Any) -> None:
        self._instance, self._fmu, self._library = instance, fmu, shared_library("master")
        version, interface = instance.version, fmu.interface
        unknowns = [each.variable for each in fmu.description.derivatives or ()]
        known = [each.derivative.valueReference for each in unknowns if each.derivative is not None]
        self._references = value_references([each.valueReference for each in unknowns]), value_references(known)
        has_jacobian = fmu.gives_directional_derivatives and len(known) == len(unknowns)

        def function(name: str, wanted: bool = True) -> int | None:
            return cast(instance.calls[f"{version.prefix}{name}"], c_void_p).value if wanted else None

        self._in_c = _Exchange(
            addressof(instance.component),
            *map(function, ("SetTime", "SetContinuousStates", version.rates, "GetEventIndicators")),
            function("CompletedIntegratorStep", bool(interface.needsCompletedIntegratorStep)),
            function("GetDirectionalDerivative", has_jacobian),
            function("SetFloat64" if version.counts_values else "SetReal"),
            *(None, 0),
            *map(address, self._references),
            len(unknowns),
            version.counts_values,
        )
        self._followed: dict[object, tuple[float, NDArray[np.uint32], RealArray]] = {}
        self._bound: list[Any] = []

    def begin(self, time: float, tolerance: float | None) -> None:
        """Begin a run after initialisation; ``tolerance`` is relative, None for that of the default experiment."""
        experiment, c = self._fmu.description.defaultExperiment, self._in_c
        stated = tolerance or float(getattr(experiment, "tolerance", None) or TOLERANCE)
        # numbers of states and event indicators; FMI 3.0 has arrays
        c.n, c.m = len(self._references[0]), int(self._fmu.description.numberOfEventIndicators or 0)
        if c.is_fmi3:
            numbers = c_size_t(), c_size_t()
            for number, name in zip(numbers, ("ContinuousStates", "EventIndicators"), strict=True):
                self._call(f"GetNumberOf{name}", byref(number))
            c.n, c.m = (each.value for each in numbers)
        self._states, self._nominals, self._absolute = np.ones((3, c.n))
        self._memory, self._pivots = np.zeros(self._library.master_exchange_size(c.n, c.m)), np.zeros(2 * c.n, np.int32)
        c.tolerance, c.least, c.status = min(max(stated, LEAST_TOLERANCE), 0.1), 0.0, fmi.OK
        c.absolute, c.nominal, c.memory, c.pivots = map(
            address, (self._absolute, self._nominals, self._memory, self._pivots)
        )
        c.record = _Record(time=time)
        self._followed.clear()
        self._bind_polynomials()
        self._restart(anew=True)

    def follow(self, key: object, references: NDArray[np.uint32], coefficients: RealArray | None) -> None:
        """Let real inputs follow polynomials of the time from now [s]; None to hold them.

        Args:
            key: what replaces its earlier polynomials.
            references: value references; in FMI 3.0 of whole arrays.
            coefficients: (powers, elements) coefficients, from power 0.
        """
        if coefficients is not None:
            self._followed[key] = self._in_c.record.time, references, coefficients
            self._instance.epoch += 1
        elif self._followed.pop(key, None) is None:
            return
        self._bind_polynomials()

    def _bind_polynomials(self) -> None:
        """Pass the polynomials of all inputs that aren't held to C, and keep them alive."""
        each = [(*found, np.empty(found[2].shape[1])) for found in self._followed.values()]
        table = (_Polynomials * len(each))()
        for group, (begin, references, coefficients, values) in zip(table, each, strict=True):
            group.references, group.references_count, group.count = address(references), references.size, values.size
            group.powers, group.coefficients = len(coefficients), address(coefficients)
            group.values, group.begin = address(values), begin
        self._bound = [each, table]
        self._in_c.polynomials, self._in_c.polynomials_count = addressof(table), len(each)

    def save(self) -> object:
        """Return what belongs to a saved state of the FMU."""
        return (
            _Record.from_buffer_copy(self._in_c.record),
            self._memory.copy(),
            self._pivots.copy(),
            dict(self._followed),
        )

    def restore(self, memory: Any) -> None:
        """Go back to what `save` returned."""
        record, self._memory[:], self._pivots[:], followed = memory
        memmove(byref(self._in_c.record), byref(record), sizeof(record))
        self._followed.clear()
        self._followed.update(followed)
        self._bind_polynomials()

    def go_on(self, *, inputs_alone: bool) -> None:
        """Go on after an event, with the states and derivatives that it has left; ``inputs_alone``: it was a jump of inputs, after
        which step and matrices stay until they prove wrong."""
        self._restart(anew=not inputs_alone or bool(self._instance.event_info.states_changed))

    def step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s], from event to event; as `Instance.step`."""
        instance, c, end, idle = self._instance, self._in_c, time + step, 0
        record, near, advance = c.record, NEAR * step + 4.0 * ulp(end), self._library.master_exchange_advance
        c.least, c.no_rollback, record.time = LEAST_STEP * step, instance.no_rollback, max(time, record.time)
        while True:
            start = record.time
            outcome = advance(c, instance.next_event if instance.next_event < end - near else end)
            if outcome != _REACHED and outcome != _EVENT:
                raise self._error(outcome)
            # state events and step events, then time events, at their very instants
            if outcome == _EVENT or record.time >= instance.next_event - near:
                if record.time < instance.next_event <= record.time + near:
                    record.time = instance.next_event
                    self._call("SetTime", record.time)
                if instance.event(record.time, end, near):
                    return
                idle = 0 if record.time > start + LEAST_STEP * step else idle + 1
                if idle > MOST_ROUNDS:
                    raise instance.hangs("has events", record.time)
            elif record.time >= end:
                return

    def _restart(self, *, anew: bool) -> None:
        """Begin or go on to integrate at the FMU's present states; ``anew``: with another step and Jacobian."""
        c = self._in_c
        if c.n and anew:
            self._call("GetContinuousStates", address(self._states), c.n)
            self._call("GetNominalsOfContinuousStates", address(self._nominals), c.n)
            self._nominals[~(self._nominals > 0.0)] = 1.0
            self._absolute[:] = ABSOLUTE * c.tolerance * self._nominals
        states = self._states if anew else self._memory[: c.n].copy()
        if (outcome := self._library.master_exchange_begin(c, address(states), anew)) != _REACHED:
            raise self._error(outcome)

    def _call(self, function: str, *arguments: Any) -> None:
        """Call a function that must succeed."""
        self._instance.must(function, function, *arguments)

    def _error(self, outcome: int) -> SlaveError:
        """Return the error of an integration that doesn't go on."""
        instance, time = self._instance, float(self._in_c.record.time)
        if outcome == _ENDS:
            return instance.ended(time)  # type: ignore[no-any-return]
        if outcome == _FAILED:
            return instance.error("the integration of its states", self._in_c.status, time)  # type: ignore[no-any-return]
        said, status = instance.log.complaint(), self._in_c.status
        reason = (
            "it can't evaluate its equations (fmi2Discard)"
            if status == fmi.DISCARD
            else "its equations have no solution there"
        )
        end = f"; its last message: {said}" if said else ""
        return SlaveError(instance.name, f"the integration of its states stopped at {time:.9g} s: {reason}{end}", time)

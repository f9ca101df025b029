"""Model exchange: integrates the states of an FMU between communication points, and finds its events.

The method is Radau IIA of order 5, by the solver of our own FMUs in C (``c-runtime/import/exchange.c``): implicit and L-stable, for
stiff and other FMUs alike, and of one step, so that a jump of the inputs at a communication point costs no start of low order. Its
matrices are kept from one communication step to the next.

A step in which an event indicator changes its domain, z > 0 or z <= 0 (FMI 2.0.4, section 3.1.1), is made once more up to the
first such change: seen on the polynomial of the step, then found by steps that end there. The states at
an event are then those of a whole step, not of its interpolation.
"""

from __future__ import annotations

from ctypes import addressof, byref, c_size_t, c_void_p, cast
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

TOLERANCE = 1e-6
"""Relative tolerance where none is given (FMI 2.0.4, section 2.1.5: fmi2SetupExperiment)."""

LEAST_TOLERANCE = 1e-12
"""Least relative tolerance: below it, rounding decides in the FMU's derivatives."""

LEAST_STEP = 1e-13
"""Progress in time that counts as none, relative to the communication step."""

_REACHED, _EVENT, _ENDS, _STUCK, _FAILED = range(5)
"""What ``flex_exchange_advance`` returns."""


_Polynomials, _Exchange = (c_structures("exchange")[f"flex_exchange{part}"] for part in ("_polynomials", ""))


class ContinuousTime:
    """Integrates the continuous states of an instance for model exchange.

    Args:
        instance: the `Instance`; its events are handled by `Instance.at_event`, which ends with `go_on`.
        fmu: its FMU.

    Raises:
        BuildError: the integrator can't be compiled, for example without a C compiler.
    """

    def __init__(self, instance: Any, fmu: Any) -> None:
        self._instance, self._fmu, self._library = instance, fmu, shared_library("exchange")
        version, interface = instance.version, fmu.interface
        unknowns = [each.variable for each in fmu.description.derivatives or ()]
        known = [each.derivative.valueReference for each in unknowns if each.derivative is not None]
        self._references = value_references([each.valueReference for each in unknowns]), value_references(known)
        has_jacobian = fmu.gives_directional_derivatives and len(known) == len(unknowns)

        def function(name: str, wanted: bool = True) -> int | None:
            return cast(instance.calls[f"{version.prefix}{name}"], c_void_p).value if wanted else None

        self._in_c = _Exchange(
            addressof(instance.component),
            *map(function, ("SetTime", "SetContinuousStates", "GetContinuousStates", "GetNominalsOfContinuousStates")),
            *map(function, (version.rates, "GetEventIndicators")),
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
        self._memory = np.zeros(self._library.flex_exchange_size(c.n, c.m), np.uint8)
        c.tolerance, c.time = min(max(stated, LEAST_TOLERANCE), 0.1), time
        c.memory, c.plant = address(self._memory), None
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
            self._followed[key] = self._in_c.time, references, coefficients
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
        return self._in_c.time, self._memory.copy(), dict(self._followed)

    def restore(self, memory: Any) -> None:
        """Go back to what `save` returned."""
        self._in_c.time, self._memory[:], followed = memory
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
        near, advance = NEAR * step + 4.0 * ulp(end), self._library.flex_exchange_advance
        c.no_rollback, c.time = instance.no_rollback, max(time, c.time)
        while True:
            start = c.time
            outcome = advance(c, instance.next_event if instance.next_event < end - near else end)
            if outcome != _REACHED and outcome != _EVENT:
                raise self._error(outcome)
            # state events and step events, then time events, at their very instants
            if outcome == _EVENT or c.time >= instance.next_event - near:
                if c.time < instance.next_event <= c.time + near:
                    c.time = instance.next_event
                    self._call("SetTime", c.time)
                if instance.event(c.time, end, near):
                    return
                idle = 0 if c.time > start + LEAST_STEP * step else idle + 1
                if idle > MOST_ROUNDS:
                    raise instance.hangs("has events", c.time)
            elif c.time >= end:
                return

    def _restart(self, *, anew: bool) -> None:
        """Begin or go on to integrate at the FMU's present states; ``anew``: with another step and Jacobian."""
        if (outcome := self._library.flex_exchange_begin(self._in_c, anew)) != _REACHED:
            raise self._error(outcome)

    def _call(self, function: str, *arguments: Any) -> None:
        """Call a function that must succeed."""
        self._instance.must(function, function, *arguments)

    def _error(self, outcome: int) -> SlaveError:
        """Return the error of an integration that doesn't go on."""
        instance, time = self._instance, float(self._in_c.time)
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

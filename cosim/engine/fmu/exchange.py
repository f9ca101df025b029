"""Model exchange: integrates the states of an FMU between communication points, and finds its events.

The method is Radau IIA of order 5 as SciPy has it (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section
IV.8): implicit and L-stable, for stiff and other FMUs alike, and of one step, so that a jump of the inputs at a communication
point costs no start of low order. Its matrices are kept from one communication step to the next.

A step in which an event indicator changes its domain, z > 0 or z <= 0 (FMI 2.0.4, section 3.1.1), is made once more up to the
first such change: found on the polynomial of the step, and again until step and polynomial end there. The states at
an event are then those of a whole step, not of its interpolation.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from ctypes import byref, c_size_t
from math import inf, ulp
from typing import Any, cast

import numpy as np
from scipy.integrate import Radau

from flexfmu.cosim.engine.errors import SlaveError
from flexfmu.cosim.engine.fmu import calls as fmi
from flexfmu.cosim.engine.fmu.calls import address, value_references
from flexfmu.cosim.engine.slave import RealArray

NEAR = 1e-9
"""Instants, and lengths of steps, closer than this fraction of the step count as one: FMUs sum up their own times."""

MOST_ROUNDS = 1000
"""Limit of the iterations of one event, and of successive events without progress in time."""

TOLERANCE, ABSOLUTE = 1e-6, 0.01
"""Relative tolerance where none is given, and absolute tolerance relative to it and to a state's nominal value (FMI 2.0.4,
section 2.1.5: fmi2SetupExperiment)."""

LEAST_TOLERANCE = 1e-12
"""Least relative tolerance: below it, rounding decides in the FMU's derivatives."""

EVENT_WIDTH = 1e-13
"""Width of the interval in which an event is located, relative to the step, beside a few roundings of the time."""

NODES = (4.0 - 6.0**0.5) / 10.0, (4.0 + 6.0**0.5) / 10.0, 1.0
"""Parts of a step at which event indicators are read, those of the method: two changes of one are seen in between."""


class _DiscardedError(Exception):
    """The FMU can't evaluate its equations here (fmi2Discard); a shorter step may succeed."""


class ContinuousTime:
    """Integrates the continuous states of an instance for model exchange.

    Args:
        instance: the `Instance`; its events are handled by `Instance.at_event`, which ends with `go_on`.
        fmu: its FMU.
    """

    def __init__(self, instance: Any, fmu: Any) -> None:
        self._instance, self._fmu = instance, fmu
        calls, prefix, rates = instance.calls, instance.version.prefix, instance.version.rates
        names = ("SetTime", "SetContinuousStates", rates, "GetEventIndicators", "GetDirectionalDerivative")
        self._set_time, self._set_states, self._get_rates, self._get_indicators, self._get_directional = (
            calls[f"{prefix}{name}"] for name in names
        )
        unknowns = [each.variable for each in fmu.description.derivatives or ()]
        self._unknown = value_references([each.valueReference for each in unknowns])
        known = [each.derivative.valueReference for each in unknowns if each.derivative is not None]
        self._known = value_references(known)
        self._has_jacobian = fmu.gives_directional_derivatives and len(known) == len(unknowns)
        self._completes = bool(fmu.interface.needsCompletedIntegratorStep)
        self._followed: dict[object, tuple[float, Callable[[float], int]]] = {}
        self._solver: Any = None

    def begin(self, time: float, tolerance: float | None) -> None:
        """Begin a run after initialisation; ``tolerance`` is relative, None for that of the default experiment."""
        experiment = self._fmu.description.defaultExperiment
        stated = tolerance or float(getattr(experiment, "tolerance", None) or TOLERANCE)
        self._tolerance = min(max(stated, LEAST_TOLERANCE), 0.1)
        # numbers of states and event indicators; FMI 3.0 has arrays
        states, indicators = len(self._unknown), int(self._fmu.description.numberOfEventIndicators or 0)
        if self._instance.version.counts_values:
            numbers = c_size_t(), c_size_t()
            for number, name in zip(numbers, ("ContinuousStates", "EventIndicators"), strict=True):
                self._vector(f"GetNumberOf{name}", byref(number))
            states, indicators = (each.value for each in numbers)
        # buffers, whose addresses are taken once
        self._states, self._rate, self._seed, self._nominals = np.zeros((4, states))
        self._indicators, self._columns = np.zeros(indicators), np.zeros((states, states))
        self._vectors = tuple((address(each), each.size) for each in (self._states, self._rate, self._indicators))
        self._followed.clear()
        self._time, self._least = time, 0.0
        self._restart()

    def follow(self, key: object, values: Callable[[float], int] | None) -> None:
        """Let inputs follow ``values``, a function of the time from now [s] that sets them; None to hold them."""
        if values is None:
            self._followed.pop(key, None)
        else:
            self._followed[key] = self._time, values
            self._instance.epoch += 1

    def save(self) -> object:
        """Return what belongs to a saved state of the FMU."""
        return copy(self._solver), self._z, self._factored, dict(self._followed)

    def restore(self, memory: Any) -> None:
        """Go back to what `save` returned."""
        solver, self._z, self._factored, followed = memory
        self._solver, self._time, self._followed = copy(solver), solver.t, dict(followed)

    def go_on(self, *, inputs_alone: bool) -> None:
        """Go on after an event, with the states and derivatives that it has left; ``inputs_alone``: it was a jump of inputs."""
        if self._instance.event_info.states_changed or not inputs_alone:
            self._restart()
            return
        # the same states, other equations: the matrices and the step stay until they prove wrong
        solver = self._solver
        solver.f, solver.sol, solver.current_jac = self._rates(solver.t, solver.y), None, False
        self._z = self._z_at(solver.t, solver.y)

    def step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s], from event to event; as `Instance.step`."""
        instance, end, idle = self._instance, time + step, 0
        near, self._least = NEAR * step + 4.0 * ulp(end), EVENT_WIDTH * step
        self._time = self._solver.t = max(time, self._solver.t)
        while True:
            bound, start = instance.next_event if instance.next_event < end - near else end, self._time
            event = bound > start and self._advance(bound)
            # state events and step events, then time events
            if event or self._time >= instance.next_event - near:
                if self._time < instance.next_event <= self._time + near:
                    self._time = self._solver.t = instance.next_event
                    instance.check("setting the time", lambda: self._place(self._time, self._solver.y))
                instance.at_event(lambda: fmi.OK, self._time)
                idle = 0 if self._time > start + EVENT_WIDTH * step else idle + 1
                if idle > MOST_ROUNDS:
                    raise instance.hangs("has events", self._time)
            elif self._time >= end:
                return

    def _advance(self, bound: float) -> bool:
        """Make one step of the method, at most up to ``bound`` and up to the first state event; return whether there is an event."""
        instance, before, factored, crossing = self._instance, self._solver, self._factored, inf
        while True:
            self._solver = solver = copy(before)
            try:
                self._take(bound, factored)
                crossing, width = self._first_crossing(), EVENT_WIDTH * solver.step_size + 4.0 * ulp(solver.t)
                if solver.t - crossing <= width or crossing == inf:
                    break
                # once more, up to the event
                bound = crossing
            except _DiscardedError:
                bound = before.t + 0.5 * (solver.t - before.t)
                self._check_discarded(bound)
        # the FMU at the end of the step
        self._time = solver.t
        if self._z.size:
            self._z = self._z_at(solver.t, solver.y)
        else:
            instance.check("setting states", lambda: self._place(solver.t, solver.y))
        enters, ends = instance.version.flag(), instance.version.flag()
        if self._completes:
            self._vector("CompletedIntegratorStep", True, byref(enters), byref(ends))
        if ends.value:
            raise instance.ended(solver.t)
        return crossing < inf or bool(enters.value)

    def _take(self, bound: float, factored: float) -> None:
        """Make one step of SciPy's method, at most up to ``bound``; its factors are those of a step of length ``factored``."""
        solver = self._solver
        wanted, length = solver.h_abs, min(solver.h_abs, bound - solver.t)
        if abs(length - factored) > NEAR * length:
            solver.LU_real = None
        solver.t_bound, solver.status = bound, "running"
        message = solver.step()
        if solver.status == "failed":
            raise self._failure(message or "the step became too small")
        if not np.isfinite(solver.f).all():
            raise _DiscardedError
        # a communication point says nothing about the step that the error admits
        self._factored = solver.t - solver.t_old
        if solver.t == bound:
            solver.h_abs = max(solver.h_abs, wanted)

    def _first_crossing(self) -> float:
        """Return the time just after the first change of an indicator's domain in the last step; infinite if there is none."""
        if not self._z.size:
            return inf
        solver, dense, positive = self._solver, self._solver.dense_output(), self._z > 0.0
        low, z_low = float(solver.t_old), self._z
        for node in NODES:
            high = float(solver.t if node == 1.0 else solver.t_old + node * (solver.t - solver.t_old))
            z_high = self._z_at(high, solver.y if node == 1.0 else dense(high))
            if ((z_high > 0.0) != positive).any():
                break
            low, z_low = high, z_high
        else:
            return inf
        # the Illinois form of the regula falsi, for the indicator that seems to change first
        width, weight, side = EVENT_WIDTH * (solver.t - solver.t_old) + 4.0 * ulp(solver.t), 1.0, 0
        while high - low > width:
            changed = (z_high > 0.0) != positive
            from_low, from_high = abs(z_low[changed]), abs(z_high[changed])
            part = float((weight * from_low / (weight * from_low + from_high + 1e-300)).min())
            middle = min(max(low + part * (high - low), low + 0.5 * width), high - 0.5 * width)
            z = self._z_at(middle, dense(middle))
            last, side = side, 1 if ((z > 0.0) != positive).any() else -1
            if side > 0:
                high, z_high = middle, z
            else:
                low, z_low = middle, z
            weight = 1.0 if side != last else weight * (0.5 if side > 0 else 2.0)
        return high

    def _restart(self) -> None:
        """Begin to integrate at the FMU's present states."""
        instance = self._instance
        for name, buffer in (("ContinuousStates", self._states), ("NominalsOfContinuousStates", self._nominals)):
            if buffer.size:
                self._vector(f"Get{name}", address(buffer), buffer.size)
        nominals = np.where(self._nominals > 0.0, self._nominals, 1.0)
        x, absolute = self._states.copy(), cast(Any, ABSOLUTE * self._tolerance * nominals)
        jacobian = self._jacobian if self._has_jacobian else None
        if not np.isfinite(self._rates(self._time, x)).all():
            raise self._failure("its derivatives aren't finite")
        self._solver = Radau(self._rates, self._time, x, inf, rtol=self._tolerance, atol=absolute, jac=jacobian)
        self._z, self._factored = self._z_at(self._time, x), 0.0
        instance.check("setting states", lambda: self._place(self._time, x))

    def _vector(self, function: str, *arguments: Any) -> None:
        """Call a function that must succeed."""
        self._instance.check(function, lambda: self._instance.call(function, *arguments))

    def _place(self, time: float, states: RealArray) -> int:
        """Set time, inputs that aren't held, and states; return the worst status."""
        component = self._instance.component
        worst = int(self._set_time(component, time))
        for begin, values in self._followed.values():
            worst = max(worst, values(time - begin))
        if states.size:
            self._states[:] = states
            worst = max(worst, self._set_states(component, *self._vectors[0]))
        return worst

    def _evaluated(self, what: str, time: float, status: int) -> bool:
        """Return whether the FMU has evaluated its equations; False if it discards them."""
        if status > fmi.DISCARD:
            raise self._instance.error(what, status, time)
        return status <= fmi.WARNING

    def _rates(self, time: float, states: RealArray) -> RealArray:
        """Return the derivatives of the states; NaN if the FMU discards them, which makes the method take a shorter step."""
        if not states.size:
            return self._rate
        status = max(self._place(time, states), self._get_rates(self._instance.component, *self._vectors[1]))
        if self._evaluated("reading derivatives", time, status):
            return self._rate.copy()
        self._check_discarded(time)
        return np.full_like(states, np.nan)

    def _check_discarded(self, time: float) -> None:
        """Raise the error of an FMU that discards its equations even this near to the last step."""
        if time - self._time <= self._least:
            raise self._failure("it can't evaluate its equations (fmi2Discard)")

    def _z_at(self, time: float, states: RealArray) -> RealArray:
        """Return the event indicators."""
        if not self._indicators.size:
            return self._indicators
        status = max(self._place(time, states), self._get_indicators(self._instance.component, *self._vectors[2]))
        if not self._evaluated("reading event indicators", time, status):
            raise _DiscardedError
        return self._indicators.copy()

    def _jacobian(self, time: float, states: RealArray) -> RealArray:
        """Return the derivatives of the rates with respect to the states, (n, n), by the FMU's directional derivatives."""
        component, counts = self._instance.component, self._instance.version.counts_values
        known = address(self._unknown), len(self._unknown), address(self._known), len(self._known), address(self._seed)
        size = (states.size,) if counts else ()
        status = self._place(time, states)
        for k, column in enumerate(self._columns):
            self._seed[:] = 0.0
            self._seed[k] = 1.0
            status = max(status, self._get_directional(component, *known, *size, address(column), *size))
        if not self._evaluated("reading directional derivatives", time, status):
            raise self._instance.error("reading directional derivatives", status, time)
        return self._columns.T.copy()

    def _failure(self, reason: str) -> SlaveError:
        """Return the error of an integration that can't go on."""
        said = self._instance.log.complaint()
        return SlaveError(
            self._instance.name,
            f"the integration of its states stopped at {self._time:.9g} s: {reason}"
            + (f"; its last message: {said}" if said else ""),
            self._time,
        )

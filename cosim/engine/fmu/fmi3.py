"""Instances of an FMI 3.0 co-simulation FMU: configured, initialised, stepped from event to event, and freed.

Event mode is used if the FMU supports it (hasEventMode): fmi3DoStep may return early at an event, which is handled
before the step goes on; steps end at announced time events, and discrete inputs change at events. Intermediate update
and clocks are not used.
"""

from __future__ import annotations

import os
from ctypes import byref, c_bool, c_double, c_void_p
from math import inf, ulp
from typing import Any

from fmpy.fmi3 import fmi3LogMessageCallback

from flexfmu.cosim.engine.errors import SlaveEnded, SlaveError
from flexfmu.cosim.engine.fmu import calls as fmi2
from flexfmu.cosim.engine.fmu.file import UnpackedFmu
from flexfmu.cosim.engine.fmu.instance import Instance, StatusCall
from flexfmu.cosim.engine.slave import Call

NEAR = 1e-9
"""Instants closer than this fraction of the communication step count as one: FMUs sum up their own times."""

MOST_ROUNDS = 1000
"""Limit of the iterations of one event, and of successive returns from fmi3DoStep without progress in time."""


class Fmi3Instance(Instance):
    """Current instance of an FMI 3.0 FMU; see `Instance`, also for further attributes.

    Attributes:
        instances: number of instances so far.
        epoch: changes whenever the FMU's inputs may differ from those set last (new instance, restored state).
    """

    prefix = "fmi3"

    def __init__(self, fmu: UnpackedFmu, fmi: fmi2.Calls) -> None:
        super().__init__(fmu, fmi)
        capabilities = fmu.description.coSimulation
        self._has_events = self._events = bool(capabilities.hasEventMode)
        self._returns_early = bool(capabilities.mightReturnEarlyFromDoStep)
        self._regular = fmu.needs_regular_steps
        folder = fmu.folder / "resources"
        self._resources = f"{folder}{os.sep}".encode() if folder.is_dir() else None
        self._receive = fmi3LogMessageCallback(self._logged)
        self._experiment: tuple[Any, ...] = ()
        self._next_event, self.epoch, self.instances = inf, 0, 0
        self._events_after: dict[int | None, float] = {}
        self._configurable = self._stepping = False
        # output arguments of fmi3DoStep and of fmi3UpdateDiscreteStates
        self._event, self._ends, self._early, self._reached = c_bool(), c_bool(), c_bool(), c_double()
        self._again, self._timed, self._unused, self._time = c_bool(), c_bool(), c_bool(), c_double()

    def _logged(self, environment: int | None, status: int, category: bytes | None, message: bytes | None) -> None:
        """Add a message of the FMU to the log."""
        self.log.add(status, (message or b"").decode("utf-8", "replace"))

    def _created(self, name: bytes) -> int | None:
        """Return a new instance; an FMU that states event mode but refuses it is instantiated without."""
        self._configurable, self._stepping, self._next_event = True, False, inf
        self.epoch, self.instances = self.epoch + 1, self.instances + 1
        self._events = self._has_events
        found = self._instantiated(name)
        if found is None and self._events:
            self._events = False
            self.log.open()
            found = self._instantiated(name)
        return found

    def _instantiated(self, name: bytes) -> int | None:
        """Return a new instance with or without event mode; None if the FMU refuses."""
        flags = False, False, self._events, self._events and self._returns_early
        arguments = name, self._guid, self._resources, *flags, None, 0, None, self._receive, None
        found: int | None = self.fmi["fmi3InstantiateCoSimulation"](*arguments)
        return found

    def set_up(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Store the experiment for fmi3EnterInitializationMode."""
        self._experiment = tolerance is not None, tolerance or 0.0, start_time, True, stop_time

    def configure(self, change: StatusCall) -> int:
        """Change structural parameters in configuration mode; return the status. From initialisation on, do nothing."""
        if not self._configurable:
            return fmi2.OK
        if (status := self._call("EnterConfigurationMode")) > fmi2.WARNING:
            return status
        status = change()
        return max(status, self._call("ExitConfigurationMode")) if status <= fmi2.WARNING else status

    def initialize(self, meanwhile: Call) -> None:
        """Initialise, with ``meanwhile`` called in initialisation mode, and handle the events at the start.

        Raises:
            SlaveError: the FMU fails.
        """
        # structural parameters are fixed from here on
        self._configurable = False
        enter = self.fmi["fmi3EnterInitializationMode"]
        self.check("initialisation", lambda: int(enter(self.component, *self._experiment)))
        meanwhile()
        self.check("initialisation", lambda: self._call("ExitInitializationMode"))
        self._initialized = True
        # the FMU is in event mode now
        if self._events:
            self._update(self._experiment[2])
        self._stepping = True

    def step(self, time: float, step: float, no_rollback: int) -> None:
        """Advance from ``time`` by ``step`` [s], from event to event.

        Raises:
            SlaveError: the FMU fails; its ``time`` is the last time reached.
            SlaveEnded: the FMU requests the end of the simulation.
        """
        now, end, idle = time, time + step, 0
        near, do_step = NEAR * step + 4.0 * ulp(end), self.fmi["fmi3DoStep"]
        results = byref(self._event), byref(self._ends), byref(self._early), byref(self._reached)
        while True:
            # up to the next announced time event, unless all steps must be equal
            announced = now < self._next_event < end - near and not self._regular
            target = self._next_event if announced else end
            length = step if (now, target) == (time, end) else target - now
            if (status := do_step(self.component, now, length, bool(no_rollback), *results)) > fmi2.WARNING:
                raise self.error(f"the step from {now:.9g} s by {length:.9g} s", status, now)
            reached = self._reached.value if self._early.value else target
            if self._ends.value:
                raise self._ended(self._reached.value)
            if self._events and (self._event.value or reached >= self._next_event - near):
                self.at_event(lambda: fmi2.OK, reached)
            # done, or on from the event
            if end - reached <= near:
                return
            idle = 0 if reached > now else idle + 1
            if idle > MOST_ROUNDS:
                raise self._hangs("returns from fmi3DoStep", reached)
            now = max(now, reached)

    @property
    def at_events(self) -> bool:
        """Whether discrete inputs must be changed at an event: the FMU has event mode and is in step mode."""
        return self._events and self._stepping

    def at_event(self, change: StatusCall, time: float | None = None) -> int:
        """Change discrete inputs at an event, or directly without event mode; return the status of the change."""
        if not self.at_events:
            return change()
        self.check("an event", lambda: self._call("EnterEventMode"))
        self._stepping = False
        status = change()
        if status <= fmi2.WARNING:
            self._update(time)
            self._stepping = True
        return status

    def _update(self, time: float | None) -> None:
        """Update discrete states until none changes any more, then enter step mode."""
        unused = byref(self._unused)
        results = byref(self._again), byref(self._ends), unused, unused, byref(self._timed), byref(self._time)
        # event iteration
        for _ in range(MOST_ROUNDS):
            self.check("an event", lambda: int(self.fmi["fmi3UpdateDiscreteStates"](self.component, *results)))
            if self._ends.value:
                raise self._ended(time)
            if not self._again.value:
                break
        else:
            raise self._hangs("wants its discrete states updated", time)
        # the next time event, and on with steps
        self._next_event = self._time.value if self._timed.value else inf
        self.check("an event", lambda: self._call("EnterStepMode"))

    def _ended(self, time: float | None) -> SlaveEnded:
        """Return the error of an FMU that requests the end of the simulation."""
        return SlaveEnded(self.name, self.log.complaint() or "terminateSimulation", time)

    def _hangs(self, what: str, time: float | None) -> SlaveError:
        """Return the error of an FMU that makes no progress."""
        return SlaveError(self.name, f"it {what} {MOST_ROUNDS} times without getting on", time)

    def get_state(self, state: c_void_p) -> int:
        """Save the state and the time of the next event; return the status."""
        status = int(self.fmi["fmi3GetFMUState"](self.component, byref(state)))
        self._events_after[state.value] = self._next_event
        return status

    def set_state(self, state: c_void_p) -> int:
        """Restore a state and the time of its next event; return the status."""
        self._next_event = self._events_after[state.value]
        self.epoch += 1
        return int(self.fmi["fmi3SetFMUState"](self.component, state))

    def free_state(self, state: c_void_p) -> int:
        """Free a saved state; return the status."""
        return int(self.fmi["fmi3FreeFMUState"](self.component, byref(state)))

    def _call(self, function: str) -> int:
        """Call a function whose only argument is the instance; return the status."""
        return int(self.fmi[f"fmi3{function}"](self.component))

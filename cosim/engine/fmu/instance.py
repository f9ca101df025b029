"""Instances of an FMU, one at a time: instantiated, the status of every call checked, stepped, and always freed.

FMUs for model exchange are stepped by `ContinuousTime`. In co-simulation event mode of FMI 3.0 is used if the FMU supports it (hasEventMode): fmi3DoStep may return early at an event, which is handled
before the step goes on; steps end at announced time events and ticks of clocks, and discrete inputs change at events. Intermediate
update is not used. Scheduled execution has neither steps nor events, only ticks.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import chdir
from ctypes import CDLL, byref, c_bool, c_double, c_int, c_void_p
from functools import lru_cache, partial
from itertools import count
from math import inf, ulp
from pathlib import Path
from time import sleep
from typing import Any, cast

from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.engine.errors import FmuFileError, SlaveEnded, SlaveError
from flexfmu.cosim.engine.fmu import calls as fmi
from flexfmu.cosim.engine.fmu.calls import FMI2, FMI3, FmuLog, FmuMode, Version
from flexfmu.cosim.engine.fmu.clocks import Clocks
from flexfmu.cosim.engine.fmu.exchange import MOST_ROUNDS, NEAR, ContinuousTime
from flexfmu.cosim.engine.fmu.file import KEPT, UnpackedFmu, attempt
from flexfmu.cosim.engine.slave import Call

StatusCall = Callable[[], int]
"""An FMI call with all arguments bound; returns an fmi2Status or fmi3Status."""

BoundStep = tuple["partial[int]", Callable[[int, float, float], BaseException]]
"""fmi2DoStep bound to its component, and a function (status, time, step) → error."""

POLL = 1e-4
"""Interval at which an FMU is polled for the end of an asynchronous step [s]."""

UNCLAIMED = (
    "fmi2DoStep returned fmi2Pending, which takes canRunAsynchronuously = true in the model description (FMI 2.0.4, section "
    "4.2.2); state it there, or export the FMU so that it completes its steps"
)
"""Message for fmi2Pending from an FMU that doesn't state canRunAsynchronuously."""

_STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
"""Names of the values of fmi2Status; fmi3Status lacks the last."""

_alive: dict[Path, str] = {}
"""Folder of an FMU that can be instantiated only once per process → name of its present instance."""

_serial = count(1)
"""Serial numbers of instance names, which must differ within a process: some FMUs keep a table of them."""


@lru_cache(maxsize=KEPT)
def load_calls(fmu: UnpackedFmu) -> fmi.Calls:
    """Load the FMU's library and return its functions; one of our own is closed with the last of them.

    A library of another tool is loaded in a child process first, in case it crashes, and stays loaded, since it may have threads.

    Raises:
        FmuFileError: the library can't be loaded, crashes, or lacks a function of its FMI version.
    """

    def load() -> CDLL:
        # some libraries look for others in their own folder
        try:
            with chdir(fmu.library.parent):
                return CDLL(str(fmu.library))
        except OSError as error:
            reason = " ".join(str(error).replace(f"{fmu.folder}/", "").split())
            raise FmuFileError(
                f"{fmu.path} can't be loaded on this machine: {reason}{fmu.tool_hint}; install what is missing, or export it "
                "for this system"
            ) from error

    if AVAILABLE and not fmu.is_ours:
        try:
            in_child(lambda: bool(load()), lambda: None, CALL_LIMIT)
        except ChildLostError as lost:
            raise FmuFileError(f"{fmu.path} is a broken FMU: loading its library, {lost}{fmu.tool_hint}") from lost
    library, version = load(), FMI3 if fmu.is_fmi3 else FMI2
    calls: fmi.Calls = attempt(fmu.path, lambda: fmi.bound_calls(library, version, fmu.kind))
    # scheduled execution has neither steps nor event mode
    if fmu.kind == "ScheduledExecution":
        names = ("EnterEventMode", "UpdateDiscreteStates", "EnterStepMode", "DoStep")
        calls |= {f"fmi3{name}": lambda *_: fmi.OK for name in names}
    if fmu.is_ours:
        fmi.close_after_use(library)
    return calls


class Instance(ABC):
    """Current instance of an FMU of either FMI version; successive instances share this object.

    Attributes:
        component: pointer to the instance; null if there is none. Calls bound to it use the instance that exists when
            they are made.
        version: what is special about its FMI version.
        calls: the FMI functions.
        log: messages of the current or last instance.
        name: name of the slave.
        no_rollback: 1 until a state is saved, then 0; argument of doStep.
        instances: number of instances so far.
        input_order: highest order of input derivatives that the FMU takes.
        epoch: changes whenever the FMU's inputs may differ from those set last (new instance, restored state).
        next_event: time of the next time event [s]; infinite if there is none.
        exchange: integrates an FMU for model exchange; None for co-simulation.
        kind: interface type.
        clocks: its clocks.
        mode: mode of the current instance.
    """

    version: Version

    def __init__(self, fmu: UnpackedFmu) -> None:
        self.component = c_void_p()
        self.calls = load_calls(fmu)
        self.log = FmuLog()
        self.name, self.no_rollback, self.instances, self.epoch = "", 1, 0, 0
        self._fmu = fmu
        self.input_order = fmu.highest_input_derivative
        self._fatal = False
        # saved states, whose memory is reused, and what belongs to each of them
        self._states: list[c_void_p] = []
        self._spare: list[c_void_p] = []
        self._saved: dict[int | None, tuple[Any, ...]] = {}
        self.next_event, self.mode, self.kind = inf, FmuMode.CONFIGURATION, fmu.kind
        # the experiment as functions of FMI take it, and whether its integration has begun
        self._experiment: tuple[float, ...] = ()
        self._has_begun = False
        # whether events are used, and the results of updates of discrete states
        self._events = fmu.is_exchange
        kind = self.version.event_info
        self.event_info = kind()
        fields = [byref(self.event_info, getattr(kind, name).offset) for name, _ in kind._fields_]
        self._update_arguments = fields if self.version is FMI3 else [byref(self.event_info)]
        self.exchange = ContinuousTime(self, fmu) if fmu.is_exchange else None
        self.clocks = Clocks(self)
        self._is_plain = not fmu.is_exchange and not fmu.clocks

    def instantiate(self, name: str) -> None:
        """Instantiate the FMU; the last instance must have been freed.

        Raises:
            SlaveError: the FMU refuses, or has an instance and allows only one per process.
        """
        self.name, self.no_rollback, self.next_event, self.mode = name, 1, inf, FmuMode.CONFIGURATION
        self.instances, self.epoch = self.instances + 1, self.epoch + 1
        self._fatal = self._has_begun = False
        self._states, self._spare = [], []
        self.clocks.reset()
        if (sole := self._fmu.folder if self._fmu.only_once_per_process else None) in _alive:
            raise SlaveError(
                name,
                f"{self._fmu.path.name} can be instantiated only once per process (canBeInstantiatedOnlyOncePerProcess = "
                f"true), and {_alive[sole]} is its instance; run one after the other, or export it for several instances",
            )
        # a name that is unique in this process; the log receives the messages
        self.log.open()
        self.component.value = self._created(f"{name} {next(_serial)}".encode())
        if self.component.value is None:
            self.log.close()
            error = self.error("instantiation", fmi.ERROR)
            raise SlaveError(name, error.reason + self._fmu.tool_hint)
        if sole is not None:
            _alive[sole] = name

    @abstractmethod
    def _created(self, name: bytes) -> int | None:
        """Return a new instance; None if the FMU refuses."""

    def set_up(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set up the experiment; FMI 3.0 takes it on entering initialisation mode."""
        self._experiment = tolerance is not None, tolerance or 0.0, start_time, True, stop_time
        if self.version is FMI2:
            self.must("fmi2SetupExperiment", "SetupExperiment", *self._experiment)

    def initialize(self, meanwhile: Call) -> None:
        """Initialise, with ``meanwhile`` called in initialisation mode, and handle the events at the start.

        Raises:
            SlaveError: the FMU fails.
        """
        self.mode = FmuMode.INITIALIZATION
        experiment, start = self._experiment if self.version is FMI3 else (), self._experiment[2]
        self.must("initialisation", "EnterInitializationMode", *experiment)
        meanwhile()
        self.clocks.begin(start)
        self.must("initialisation", "ExitInitializationMode")
        # an FMU with event mode is in it now, and stays there for the clocks that tick
        self.mode = FmuMode.OPEN_EVENT
        self.check("activating clocks", lambda: self.clocks.tick(start))
        if not self.clocks.active:
            self._leave_events(start)

    def step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s].

        Raises:
            SlaveError: the FMU fails or completes only part of the step; its ``time`` is the last time reached.
            SlaveEnded: the FMU requests the end of the simulation.
        """
        # most FMUs are stepped often, and have no clocks, for which alone events stay open
        if self._is_plain:
            self._step(time, step)
            return
        if self.mode is FmuMode.OPEN_EVENT:
            self._leave_events(time)
        if self.exchange is not None:
            self.exchange.step(time, step)
        else:
            self._step(time, step)
        self.clocks.now = time + step

    @abstractmethod
    def _step(self, time: float, step: float) -> None:
        """Advance in co-simulation."""

    def bound_step(self) -> BoundStep | None:
        """Return fmi2DoStep bound to the component and a function for the error of a failed step; None if `step` does
        more than one call."""
        return None

    @property
    def at_events(self) -> bool:
        """Whether discrete inputs must be changed at an event: the FMU has event mode and isn't in it."""
        return self._events and self.mode is FmuMode.STEP

    def open_event(self) -> None:
        """Enter event mode, unless the FMU is in it, until the next step begins."""
        if self.at_events:
            self.must("an event", "EnterEventMode")
        self.mode = FmuMode.OPEN_EVENT

    def event(self, time: float, end: float, near: float) -> bool:
        """Handle an event at ``time`` in a step up to ``end`` [s]; return whether it stays open, for the ticks of clocks at the end."""
        stays = self.clocks.next <= time + near and end - time <= near
        if stays:
            self.open_event()
            self.check("activating clocks", lambda: self.clocks.tick(time, near))
        else:
            self.at_event(lambda: self.clocks.tick(time, near), time)
        return stays

    def at_event(self, change: StatusCall, time: float | None = None) -> int:
        """Change discrete inputs at an event, or directly without event mode; return the status of the change."""
        if not self.at_events:
            return change()
        self.must("an event", "EnterEventMode")
        self.mode = FmuMode.EVENT
        status = change()
        if status <= fmi.WARNING:
            self._leave_events(time)
        return status

    def _leave_events(self, time: float | None) -> None:
        """Update discrete states until none changes any more, then leave event mode; without event mode just go on."""
        if self._events:
            self._update(time)
        self.mode, begins, self._has_begun = FmuMode.STEP, not self._has_begun, True
        if self.exchange is not None and begins:
            has_tolerance, tolerance, start, *_ = self._experiment
            self.exchange.begin(start, tolerance if has_tolerance else None)
        elif self.exchange is not None:
            self.exchange.go_on(inputs_alone=time is None)

    def _update(self, time: float | None) -> None:
        """Iterate over the events of this instant, ticks of clocks included, and leave event mode."""
        info, clocks, states_changed = self.event_info, self.clocks, False
        for _ in range(MOST_ROUNDS):
            self.check("reading clocked variables", clocks.refresh)
            self.must("an event", self.version.update, *self._update_arguments)
            if info.ends:
                raise self.ended(time)
            states_changed = states_changed or bool(info.states_changed or info.nominals_changed)
            ticks = clocks.updated()
            if not (info.again or ticks):
                break
        else:
            raise self.hangs("wants its discrete states updated", time)
        # the next time event or tick, and on with steps
        info.states_changed = states_changed
        self.next_event = min(info.time if info.timed else inf, clocks.next)
        mode = "EnterStepMode" if self.exchange is None else "EnterContinuousTimeMode"
        self.must("an event", mode)

    def ended(self, time: float | None) -> SlaveEnded:
        """Return the error of an FMU that requests the end of the simulation."""
        return SlaveEnded(self.name, self.log.complaint() or "terminateSimulation", time)

    def hangs(self, what: str, time: float | None) -> SlaveError:
        """Return the error of an FMU that makes no progress."""
        return SlaveError(self.name, f"it {what} {MOST_ROUNDS} times without getting on", time)

    def configure(self, change: StatusCall) -> int:
        """Change structural parameters in configuration mode; return the status. From initialisation on, do nothing."""
        if self.mode is not FmuMode.CONFIGURATION:
            return fmi.OK
        if (status := self.call("EnterConfigurationMode")) > fmi.WARNING:
            return status
        status = change()
        return max(status, self.call("ExitConfigurationMode")) if status <= fmi.WARNING else status

    def call(self, function: str, *arguments: Any) -> int:
        """Call a function, its name without prefix, of this instance; return the status."""
        return int(self.calls[f"{self.version.prefix}{function}"](self.component, *arguments))

    def accepts(self, call: StatusCall) -> bool:
        """Make a call that the FMU may refuse; return whether it succeeded.

        Raises:
            SlaveError: the call failed with a fatal error.
        """
        if (status := call()) == fmi.FATAL:
            raise self.error("a call", status)
        return status <= fmi.WARNING

    def check(self, what: str, call: StatusCall) -> None:
        """Make a call; ``what`` names it in errors.

        Raises:
            SlaveError: the call failed, with the FMU's message.
        """
        if (status := call()) > fmi.WARNING:
            raise self.error(what, status)

    def must(self, what: str, function: str, *arguments: Any) -> None:
        """Call a function, its name without prefix, that must succeed; see `check`."""
        self.check(what, lambda: self.call(function, *arguments))

    def error(self, what: str, status: int, time: float | None = None) -> SlaveError:
        """Return the error with the FMU's message, or with the status if it gave none."""
        self._fatal = self._fatal or status == fmi.FATAL
        name = f"{self.version.prefix}{_STATUS[status]}" if 0 <= status < len(_STATUS) else f"status {status}"
        return SlaveError(self.name, self.log.complaint() or f"{what} failed with {name}; the FMU gave no reason", time)

    def save(self) -> object:
        """Return the complete state, in the memory of a released state if there is one; valid as long as the instance."""
        state = self._spare.pop() if self._spare else c_void_p()
        try:
            self.must("saving the state", f"Get{self.version.state}", byref(state))
        finally:
            # even after a failure, its memory must be freed at the end
            if state.value is not None and not any(each is state for each in self._states):
                self._states.append(state)
        parts = self.exchange and self.exchange.save(), self.clocks.save()
        self._saved[state.value] = self.next_event, self.mode, self._has_begun, *parts
        self.no_rollback = 0
        return state

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one to be saved."""
        if isinstance(state, c_void_p) and not any(each is state for each in self._spare):
            self._spare.append(state)

    def restore(self, state: object) -> None:
        """Restore a saved state."""
        saved = cast(c_void_p, state)
        self.next_event, self.mode, self._has_begun, memory, ticks = self._saved[saved.value]
        self.epoch += 1
        self.must("restoring a state", f"Set{self.version.state}", saved)
        if self.exchange is not None:
            self.exchange.restore(memory)
        self.clocks.restore(ticks)

    def free(self) -> None:
        """Terminate and free the instance with its states; after a fatal error no FMI function may be called."""
        if not self._fatal:
            for state in self._states:
                self.call(f"Free{self.version.state}", byref(state))
            if self.initialized:
                self.call("Terminate")
            self.calls[f"{self.version.prefix}FreeInstance"](self.component)
        self.component.value = None
        self.log.close()
        _alive.pop(self._fmu.folder, None)

    @property
    def initialized(self) -> bool:
        """Whether the FMU has been initialised, without a fatal error since."""
        return self.mode not in (FmuMode.CONFIGURATION, FmuMode.INITIALIZATION) and not self._fatal


class Fmi2Instance(Instance):
    """Current instance of an FMI 2.0 FMU; see `Instance`."""

    version = FMI2

    def __init__(self, fmu: UnpackedFmu) -> None:
        super().__init__(fmu)
        self._resources = Path(fmu.folder, "resources").as_uri().encode()
        if not fmu.is_exchange:
            self._do_step: partial[int] = partial(self.calls["fmi2DoStep"], self.component)
        self._asynchronous = bool(getattr(fmu.interface, "canRunAsynchronuously", False))

    def _created(self, name: bytes) -> int | None:
        callbacks, kind = byref(self.log.callbacks), fmi.MODEL_EXCHANGE if self.exchange else fmi.CO_SIMULATION
        found: int | None = self.calls["fmi2Instantiate"](
            name, kind, self._fmu.description.guid.encode(), self._resources, callbacks, 0, 0
        )
        return found

    def _step(self, time: float, step: float) -> None:
        status = self._do_step(time, step, self.no_rollback)
        # an asynchronous step: wait until it is done
        if status == fmi.PENDING and self._asynchronous:
            pending, asked = c_int(status), fmi.OK
            while pending.value == fmi.PENDING and asked <= fmi.WARNING:
                sleep(POLL)
                asked = self.call("GetStatus", fmi.DO_STEP_STATUS, byref(pending))
            status = asked if asked > fmi.WARNING else pending.value
        if status > fmi.WARNING:
            raise self.step_error(status, time, step)

    def bound_step(self) -> BoundStep | None:
        return None if self._asynchronous or self.exchange is not None else (self._do_step, self.step_error)

    def step_error(self, status: int, time: float, step: float) -> SlaveError:
        """Return the error of a failed step, with the last time that the FMU reached."""
        reached, terminated = c_double(time), c_int(0)
        error = self.error(f"the step from {time:.9g} s by {step:.9g} s", status, time)
        if status == fmi.PENDING and not self._asynchronous:
            said = self.log.complaint()
            return SlaveError(error.slave, f"{UNCLAIMED}; its last message: {said}" if said else UNCLAIMED, time)
        if status != fmi.DISCARD:
            return error
        self.call("GetRealStatus", fmi.LAST_SUCCESSFUL_TIME, byref(reached))
        self.call("GetBooleanStatus", fmi.TERMINATED, byref(terminated))
        if terminated.value:
            return SlaveEnded(error.slave, self.log.complaint() or "fmi2Terminated", reached.value)
        if self._fmu.is_ours:
            return SlaveError(error.slave, error.reason, reached.value)
        # FMI 2.0, 4.2.2: a shorter step may succeed, from a state saved before the discarded step
        goes_back, remedy = (
            self._fmu.interface.canGetAndSetFMUstate,
            "step_control, which goes back and tries smaller steps",
        )
        done = f"{reached.value - time:.9g} s of the step of {step:.9g} s are done (fmi2Discard)"
        reason = f"{error.reason}; {done}, take {remedy if goes_back else 'a smaller communication step'}"
        return SlaveError(error.slave, reason, reached.value)


class Fmi3Instance(Instance):
    """Current instance of an FMI 3.0 FMU; see `Instance`."""

    version = FMI3

    def __init__(self, fmu: UnpackedFmu) -> None:
        super().__init__(fmu)
        # the breakpoints of an exported trajectory are stated, and all steps end there
        self._has_events = fmu.kind != "CoSimulation" or bool(fmu.interface.hasEventMode and fmu.breakpoints is None)
        self._regular = fmu.needs_regular_steps
        folder = fmu.folder / "resources"
        self._resources = f"{folder}{os.sep}".encode() if folder.is_dir() else None
        # output arguments of fmi3DoStep
        self._event, self._ends, self._early, self._reached = c_bool(), c_bool(), c_bool(), c_double()

    def _created(self, name: bytes) -> int | None:
        # an FMU that states event mode but refuses it is instantiated without
        returns_early = bool(getattr(self._fmu.interface, "mightReturnEarlyFromDoStep", False))
        found: int | None = None
        for uses_events in (True, False) if self._has_events and self._is_plain else (self._has_events,):
            self._events = uses_events
            self.log.open()
            # other FMUs may log a lot; ours say only so why a step was discarded
            arguments = name, self._fmu.description.guid.encode(), self._resources, False, self._fmu.is_ours
            log = None, self.log.receive
            more = {
                "CoSimulation": (self._events, self._events and returns_early, None, 0, *log, None),
                "ModelExchange": log,
                "ScheduledExecution": (*log, fmi.CLOCK_UPDATE, None, None),
            }
            found = self.calls[f"fmi3Instantiate{self.kind}"](*arguments, *more[self.kind])
            if found is not None:
                break
        return found

    def _step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s], from event to event.

        Raises:
            SlaveError: the FMU fails; its ``time`` is the last time reached.
            SlaveEnded: the FMU requests the end of the simulation.
        """
        now, end, idle = time, time + step, 0
        near, do_step = NEAR * step + 4.0 * ulp(end), self.calls["fmi3DoStep"]
        results = byref(self._event), byref(self._ends), byref(self._early), byref(self._reached)
        while True:
            # up to the next announced time event, unless all steps must be equal
            announced = now < self.next_event < end - near and not self._regular
            target = self.next_event if announced else end
            length = step if (now, target) == (time, end) else target - now
            if (status := do_step(self.component, now, length, bool(self.no_rollback), *results)) > fmi.WARNING:
                raise self.error(f"the step from {now:.9g} s by {length:.9g} s", status, now)
            reached = self._reached.value if self._early.value else target
            if self._ends.value:
                raise self.ended(self._reached.value)
            happens = self._events and (self._event.value or reached >= self.next_event - near)
            if happens and self.event(reached, end, near):
                return
            # done, or on from the event
            if end - reached <= near:
                return
            idle = 0 if reached > now else idle + 1
            if idle > MOST_ROUNDS:
                raise self.hangs("returns from fmi3DoStep", reached)
            now = max(now, reached)


class Checked:
    """An FMI call that raises `SlaveError` with the FMU's message if it fails.

    Attributes:
        call: the FMI call; returns its status.
    """

    __slots__ = ("_instance", "_what", "call")

    def __init__(self, instance: Instance, what: str, call: StatusCall) -> None:
        self.call = call
        self._instance, self._what = instance, what

    def __call__(self) -> None:
        if (status := self.call()) > fmi.WARNING:
            raise self.error(status)

    def error(self, status: int) -> SlaveError:
        """Return the error of a failed call."""
        return self._instance.error(self._what, status)

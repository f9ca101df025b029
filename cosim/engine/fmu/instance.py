"""Instances of an FMU, one at a time: instantiated, the status of every call checked, stepped, and always freed.

FMUs for model exchange are stepped by `ContinuousTime`. In co-simulation event mode of FMI 3.0 is used if the FMU supports it (hasEventMode): fmi3DoStep may return early at an event, which is handled
before the step goes on; steps end at announced time events and ticks of clocks, and discrete inputs change at events. Intermediate
update is not used. Scheduled execution has neither steps nor events, only ticks.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from ctypes import byref, c_bool, c_double, c_int, c_void_p
from functools import lru_cache, partial
from itertools import count
from math import inf, ulp
from pathlib import Path
from time import sleep
from typing import Any, cast

from fmpy.fmi1 import _FMU
from fmpy.fmi3 import fmi3ClockUpdateCallback, fmi3LogMessageCallback

from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.engine.errors import FmuFileError, SlaveEnded, SlaveError
from flexfmu.cosim.engine.fmu import calls as fmi
from flexfmu.cosim.engine.fmu.calls import FMI2, FMI3, FmuLog, Version
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
    """Load the FMU's library with fmpy and return its functions; one of our own is closed with the last of them.

    A library of another tool is loaded in a child process first, in case it crashes, and stays loaded, since it may have threads.

    Raises:
        FmuFileError: the library can't be loaded, crashes, or lacks a function of its FMI version.
    """
    description = fmu.description
    arguments = {
        "guid": description.guid,
        "modelIdentifier": fmu.interface.modelIdentifier,
        "unzipDirectory": str(fmu.folder),
    }
    if fmu.is_fmi3:
        # fmpy's class for FMI 3.0 requires the functions of all interface types; its base class does not
        arguments["libraryPath"] = str(fmu.library)
    if AVAILABLE and not fmu.is_ours:
        try:
            in_child(lambda: bool(_loaded(fmu, arguments)), lambda: None, CALL_LIMIT)
        except ChildLostError as lost:
            raise FmuFileError(f"{fmu.path} is a broken FMU: loading its library, {lost}{fmu.tool_hint}") from lost
    library, version = _loaded(fmu, arguments), FMI3 if fmu.is_fmi3 else FMI2
    signatures = {**version.signatures, **version.interfaces[fmu.kind]}
    calls: fmi.Calls = attempt(fmu.path, lambda: fmi.bound_calls(library, signatures))
    # scheduled execution has neither steps nor event mode
    if fmu.kind == "ScheduledExecution":
        names = ("EnterEventMode", "UpdateDiscreteStates", "EnterStepMode", "DoStep")
        calls |= {f"fmi3{name}": lambda *_: fmi.OK for name in names}
    if fmu.is_ours:
        fmi.close_after_use(library)
    return calls


def _loaded(fmu: UnpackedFmu, arguments: Mapping[str, str]) -> Any:
    """Return the library loaded by fmpy.

    Raises:
        FmuFileError: the library can't be loaded, with the system's reason.
    """
    try:
        return _FMU(**arguments).dll
    except Exception as error:
        # fmpy's message has the library's temporary path before the reason
        reason = " ".join(str(error).replace(f"{fmu.folder}/", "").split()).partition(" shared library ")[2] or str(
            error
        )
        raise FmuFileError(
            f"{fmu.path} can't be loaded on this machine: {reason}{fmu.tool_hint}; install what is missing, or export it for "
            "this system"
        ) from error


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
        clocks: its clocks; None without any.
    """

    version: Version

    def __init__(self, fmu: UnpackedFmu) -> None:
        self.component = c_void_p()
        self.calls = load_calls(fmu)
        self.log = FmuLog()
        self.name, self.no_rollback, self.instances, self.epoch = "", 1, 0, 0
        self._fmu = fmu
        self.input_order = fmu.highest_input_derivative
        self._guid = fmu.description.guid.encode()
        self._initialized = self._fatal = False
        # saved states, whose memory is reused, and the time of the next event after each of them
        self._states: list[c_void_p] = []
        self._spare: list[c_void_p] = []
        self._events_after: dict[int | None, tuple[Any, ...]] = {}
        self.next_event = inf
        # event mode: whether the FMU has it and has left it, the start of the run, and the results of its updates
        self._has_events, self._events, self._stepping, self._start = False, fmu.is_exchange, False, 0.0
        self._starting = True
        self._tolerance: float | None = None
        kind = self.version.event_info
        self.event_info = kind()
        fields = [byref(self.event_info, getattr(kind, name).offset) for name, _ in kind._fields_]
        self._update_arguments = fields if self.version is FMI3 else [byref(self.event_info)]
        self.exchange = ContinuousTime(self, fmu) if fmu.is_exchange else None
        # clocks, and whether the FMU stays in event mode for their ticks until the next step
        self.kind, self.clocks, self._open = fmu.kind, cast("Clocks | None", None), False

    def instantiate(self, name: str) -> None:
        """Instantiate the FMU; the last instance must have been freed.

        Raises:
            SlaveError: the FMU refuses, or has an instance and allows only one per process.
        """
        self.name, self.no_rollback, self.next_event, self._stepping = name, 1, inf, False
        self.instances, self.epoch = self.instances + 1, self.epoch + 1
        self._initialized = self._fatal = False
        self._states, self._spare, self._open = [], [], False
        if self.clocks is not None:
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
        """Set up the experiment."""
        self._start, self._tolerance = start_time, tolerance
        self._set_up(tolerance is not None, tolerance or 0.0, start_time, True, stop_time)

    @abstractmethod
    def _set_up(self, *experiment: float) -> None:
        """Set up the experiment: whether there is a tolerance, tolerance, start, whether there is a stop, stop."""

    def initialize(self, meanwhile: Call) -> None:
        """Initialise, with ``meanwhile`` called in initialisation mode, and handle the events at the start.

        Raises:
            SlaveError: the FMU fails.
        """
        self._enter_initialization()
        meanwhile()
        if self.clocks is not None:
            self.clocks.begin(self._start)
        self.check("initialisation", lambda: self.call("ExitInitializationMode"))
        self._initialized = self._starting = True
        # an FMU with event mode is in it now
        if self.clocks is not None:
            self._open = True
            self.check("activating clocks", self.clocks.tick_at_start)
        else:
            self._leave_events(self._start)

    @abstractmethod
    def _enter_initialization(self) -> None:
        """Enter initialisation mode."""

    def step(self, time: float, step: float) -> None:
        """Advance from ``time`` by ``step`` [s].

        Raises:
            SlaveError: the FMU fails or completes only part of the step; its ``time`` is the last time reached.
            SlaveEnded: the FMU requests the end of the simulation.
        """
        if self._open:
            self._leave_events(time)
        if self.exchange is not None:
            self.exchange.step(time, step)
        else:
            self._step(time, step)
        if self.clocks is not None:
            self.clocks.now = time + step

    @abstractmethod
    def _step(self, time: float, step: float) -> None:
        """Advance in co-simulation."""

    def bound_step(self) -> BoundStep | None:
        """Return fmi2DoStep bound to the component and a function for the error of a failed step; None if `step` does
        more than one call."""
        return None

    @property
    def is_stepping(self) -> bool:
        """Whether the FMU has been initialised and isn't in event mode."""
        return self._stepping

    @property
    def at_events(self) -> bool:
        """Whether discrete inputs must be changed at an event: the FMU has event mode and isn't in it."""
        return self._events and self._stepping

    def open_event(self) -> None:
        """Enter event mode, unless the FMU is in it, until the next step begins."""
        if self.at_events:
            self.check("an event", lambda: self.call("EnterEventMode"))
        self._stepping, self._open = False, True

    def event(self, time: float, end: float, near: float) -> bool:
        """Handle an event at ``time`` in a step up to ``end`` [s]; return whether it stays open, for the ticks of clocks at the end."""
        clocks = self.clocks
        if clocks is not None and clocks.next <= time + near and end - time <= near:
            self.open_event()
            self.check("activating clocks", lambda: clocks.tick(time, near))
        else:
            self.at_event(lambda: fmi.OK if clocks is None else clocks.tick(time, near), time)
        return self._open

    def at_event(self, change: StatusCall, time: float | None = None) -> int:
        """Change discrete inputs at an event, or directly without event mode; return the status of the change."""
        if not self.at_events:
            return change()
        self.check("an event", lambda: self.call("EnterEventMode"))
        self._stepping = False
        status = change()
        if status <= fmi.WARNING:
            self._leave_events(time)
        return status

    def _leave_events(self, time: float | None) -> None:
        """Update discrete states until none changes any more, then leave event mode; without event mode just go on."""
        info, clocks, states_changed = self.event_info, self.clocks, False
        # event iteration
        for _ in range(MOST_ROUNDS if self._events else 0):
            if clocks is not None:
                self.check("reading clocked variables", clocks.refresh)
            self.check("an event", lambda: self.call(self.version.update, *self._update_arguments))
            if info.ends:
                raise self.ended(time)
            states_changed = states_changed or bool(info.states_changed or info.nominals_changed)
            ticks = clocks is not None and clocks.updated()
            if not (info.again or ticks):
                break
        else:
            if self._events:
                raise self.hangs("wants its discrete states updated", time)
        # the next time event or tick, and on with steps
        if self._events:
            info.states_changed = states_changed
            self.next_event = min(info.time if info.timed else inf, clocks.next if clocks is not None else inf)
            mode = "EnterStepMode" if self.exchange is None else "EnterContinuousTimeMode"
            self.check("an event", lambda: self.call(mode))
        self._stepping, self._open = True, False
        if self.exchange is not None and self._starting:
            self.exchange.begin(self._start, self._tolerance)
        elif self.exchange is not None:
            self.exchange.go_on(inputs_alone=time is None)
        self._starting = False

    def ended(self, time: float | None) -> SlaveEnded:
        """Return the error of an FMU that requests the end of the simulation."""
        return SlaveEnded(self.name, self.log.complaint() or "terminateSimulation", time)

    def hangs(self, what: str, time: float | None) -> SlaveError:
        """Return the error of an FMU that makes no progress."""
        return SlaveError(self.name, f"it {what} {MOST_ROUNDS} times without getting on", time)

    def configure(self, change: StatusCall) -> int:
        """Change structural parameters in configuration mode; return the status. From initialisation on, do nothing."""
        return change()

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

    def error(self, what: str, status: int, time: float | None = None) -> SlaveError:
        """Return the error with the FMU's message, or with the status if it gave none."""
        self._fatal = self._fatal or status == fmi.FATAL
        name = f"{self.version.prefix}{_STATUS[status]}" if 0 <= status < len(_STATUS) else f"status {status}"
        return SlaveError(self.name, self.log.complaint() or f"{what} failed with {name}; the FMU gave no reason", time)

    def save(self) -> object:
        """Return the complete state, in the memory of a released state if there is one; valid as long as the instance."""
        state = self._spare.pop() if self._spare else c_void_p()
        try:
            self.check("saving the state", lambda: self.call(f"Get{self.version.state}", byref(state)))
        finally:
            # even after a failure, its memory must be freed at the end
            if state.value is not None and not any(each is state for each in self._states):
                self._states.append(state)
        parts = self.exchange and self.exchange.save(), self.clocks and self.clocks.save()
        self._events_after[state.value] = self.next_event, self._stepping, self._open, self._starting, *parts
        self.no_rollback = 0
        return state

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one to be saved."""
        if isinstance(state, c_void_p) and not any(each is state for each in self._spare):
            self._spare.append(state)

    def restore(self, state: object) -> None:
        """Restore a saved state."""
        saved = cast(c_void_p, state)
        self.next_event, self._stepping, self._open, self._starting, memory, ticks = self._events_after[saved.value]
        self.epoch += 1
        self.check("restoring a state", lambda: self.call(f"Set{self.version.state}", saved))
        if self.exchange is not None:
            self.exchange.restore(memory)
        if self.clocks is not None:
            self.clocks.restore(ticks)

    def free(self) -> None:
        """Terminate and free the instance with its states; after a fatal error no FMI function may be called."""
        if not self._fatal:
            for state in self._states:
                self.call(f"Free{self.version.state}", byref(state))
            if self._initialized:
                self.call("Terminate")
            self.calls[f"{self.version.prefix}FreeInstance"](self.component)
        self.component.value = None
        self.log.close()
        _alive.pop(self._fmu.folder, None)

    @property
    def initialized(self) -> bool:
        """Whether the FMU has been initialised, without a fatal error since."""
        return self._initialized and not self._fatal


class Fmi2Instance(Instance):
    """Current instance of an FMI 2.0 FMU; see `Instance`."""

    version = FMI2

    def __init__(self, fmu: UnpackedFmu) -> None:
        super().__init__(fmu)
        self._resources = Path(fmu.folder, "resources").as_uri().encode()
        if not fmu.is_exchange:
            self._do_step: partial[int] = partial(self.calls["fmi2DoStep"], self.component)
        self._asynchronous = bool(getattr(fmu.interface, "canRunAsynchronuously", False))
        self._can_go_back = bool(fmu.interface.canGetAndSetFMUstate)

    def _created(self, name: bytes) -> int | None:
        callbacks, kind = byref(self.log.callbacks), fmi.MODEL_EXCHANGE if self.exchange else fmi.CO_SIMULATION
        found: int | None = self.calls["fmi2Instantiate"](name, kind, self._guid, self._resources, callbacks, 0, 0)
        return found

    def _set_up(self, *experiment: float) -> None:
        self.check("fmi2SetupExperiment", lambda: self.call("SetupExperiment", *experiment))

    def _enter_initialization(self) -> None:
        self.check("initialisation", lambda: self.call("EnterInitializationMode"))

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
        remedy = "step_control, which goes back and tries smaller steps"
        done = f"{reached.value - time:.9g} s of the step of {step:.9g} s are done (fmi2Discard)"
        reason = f"{error.reason}; {done}, take {remedy if self._can_go_back else 'a smaller communication step'}"
        return SlaveError(error.slave, reason, reached.value)


class Fmi3Instance(Instance):
    """Current instance of an FMI 3.0 FMU; see `Instance`."""

    version = FMI3

    def __init__(self, fmu: UnpackedFmu) -> None:
        super().__init__(fmu)
        self._has_events = self._events = fmu.kind != "CoSimulation" or bool(fmu.interface.hasEventMode)
        self._returns_early = bool(getattr(fmu.interface, "mightReturnEarlyFromDoStep", False))
        self._regular = fmu.needs_regular_steps
        folder = fmu.folder / "resources"
        self._resources = f"{folder}{os.sep}".encode() if folder.is_dir() else None
        self._receive, self._notice = fmi3LogMessageCallback(self._logged), fmi3ClockUpdateCallback(lambda _: None)
        self._experiment: tuple[float, ...] = ()
        self._configurable = False
        # output arguments of fmi3DoStep
        self._event, self._ends, self._early, self._reached = c_bool(), c_bool(), c_bool(), c_double()

    def _logged(self, environment: int | None, status: int, category: bytes | None, message: bytes | None) -> None:
        """Add a message of the FMU to the log."""
        self.log.add(status, (message or b"").decode("utf-8", "replace"))

    def _created(self, name: bytes) -> int | None:
        """Return a new instance; an FMU that states event mode but refuses it is instantiated without."""
        self._configurable, self._events = True, self._has_events
        found = self._instantiated(name)
        if found is None and self._events and self.kind == "CoSimulation" and self.clocks is None:
            self._events = False
            self.log.open()
            found = self._instantiated(name)
        return found

    def _instantiated(self, name: bytes) -> int | None:
        """Return a new instance with or without event mode; None if the FMU refuses."""
        # other FMUs may log a lot; ours say only so why a step was discarded
        arguments = name, self._guid, self._resources, False, self._fmu.is_ours
        found: int | None
        more = {
            "CoSimulation": (self._events, self._events and self._returns_early, None, 0, None, self._receive, None),
            "ModelExchange": (None, self._receive),
            "ScheduledExecution": (None, self._receive, self._notice, None, None),
        }
        found = self.calls[f"fmi3Instantiate{self.kind}"](*arguments, *more[self.kind])
        return found

    def _set_up(self, *experiment: float) -> None:
        # for fmi3EnterInitializationMode
        self._experiment = experiment

    def configure(self, change: StatusCall) -> int:
        if not self._configurable:
            return fmi.OK
        if (status := self.call("EnterConfigurationMode")) > fmi.WARNING:
            return status
        status = change()
        return max(status, self.call("ExitConfigurationMode")) if status <= fmi.WARNING else status

    def _enter_initialization(self) -> None:
        # structural parameters are fixed from here on
        self._configurable = False
        self.check("initialisation", lambda: self.call("EnterInitializationMode", *self._experiment))

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

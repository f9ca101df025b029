"""Instances of an FMU, one at a time: instantiated, the status of every call checked, and always freed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from ctypes import byref, c_double, c_int, c_void_p
from functools import cache, partial
from itertools import count
from pathlib import Path
from time import sleep
from typing import Any, cast

from fmpy.fmi1 import _FMU

from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.engine.errors import FmuFileError, SlaveEnded, SlaveError
from flexfmu.cosim.engine.fmu import calls as fmi2
from flexfmu.cosim.engine.fmu.file import UnpackedFmu, attempt
from flexfmu.cosim.engine.fmu.log import FmuLog
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


@cache
def load_calls(fmu: UnpackedFmu) -> fmi2.Calls:
    """Load the FMU's library with fmpy and return its functions; the library stays loaded.

    A library of another tool is loaded in a child process first, in case it crashes.

    Raises:
        FmuFileError: the library can't be loaded, crashes, or lacks a function of its FMI version.
    """
    description = fmu.description
    arguments = {
        "guid": description.guid,
        "modelIdentifier": description.coSimulation.modelIdentifier,
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
    library, signatures = _loaded(fmu, arguments), fmi2.FMI3_SIGNATURES if fmu.is_fmi3 else fmi2.FMI2_SIGNATURES
    calls: fmi2.Calls = attempt(fmu.path, lambda: fmi2.bound_calls(library, signatures))
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
        fmi: the FMI functions.
        log: messages of the current or last instance.
        name: name of the slave.
    """

    prefix: str

    def __init__(self, fmu: UnpackedFmu, fmi: fmi2.Calls) -> None:
        self.component = c_void_p()
        self.fmi = fmi
        self.log = FmuLog()
        self.name = ""
        self._fmu = fmu
        self._guid = fmu.description.guid.encode()
        self._initialized = self._fatal = False

    def instantiate(self, name: str) -> None:
        """Instantiate the FMU; the last instance must have been freed.

        Raises:
            SlaveError: the FMU refuses, or has an instance and allows only one per process.
        """
        self.name, self._initialized, self._fatal = name, False, False
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
            error = self.error("instantiation", fmi2.ERROR)
            raise SlaveError(name, error.reason + self._fmu.tool_hint)
        if sole is not None:
            _alive[sole] = name

    @abstractmethod
    def _created(self, name: bytes) -> int | None:
        """Return a new instance; None if the FMU refuses."""

    @abstractmethod
    def set_up(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set up the experiment."""

    @abstractmethod
    def initialize(self, meanwhile: Call) -> None:
        """Enter initialisation mode, call ``meanwhile``, and exit initialisation mode."""

    @abstractmethod
    def step(self, time: float, step: float, no_rollback: int) -> None:
        """Advance from ``time`` by ``step`` [s]; ``no_rollback`` = 1 if no earlier state will be restored.

        Raises:
            SlaveError: the FMU fails or completes only part of the step; its ``time`` is the last time reached.
            SlaveEnded: the FMU requests the end of the simulation.
        """

    def bound_step(self) -> BoundStep | None:
        """Return fmi2DoStep bound to the component and a function for the error of a failed step; None if `step` does
        more than one call."""
        return None

    @abstractmethod
    def get_state(self, state: c_void_p) -> int:
        """Save the state; return the status."""

    @abstractmethod
    def set_state(self, state: c_void_p) -> int:
        """Restore a state; return the status."""

    @abstractmethod
    def free_state(self, state: c_void_p) -> int:
        """Free a saved state; return the status."""

    def accepts(self, call: StatusCall) -> bool:
        """Make a call that the FMU may refuse; return whether it succeeded.

        Raises:
            SlaveError: the call failed with a fatal error.
        """
        if (status := call()) == fmi2.FATAL:
            raise self.error("a call", status)
        return status <= fmi2.WARNING

    def check(self, what: str, call: StatusCall) -> None:
        """Make a call; ``what`` names it in errors.

        Raises:
            SlaveError: the call failed, with the FMU's message.
        """
        if (status := call()) > fmi2.WARNING:
            raise self.error(what, status)

    def checked(self, what: str, call: StatusCall) -> Checked:
        """Return the call as one that raises `SlaveError` with the FMU's message if it fails."""
        return Checked(self, what, call)

    def error(self, what: str, status: int, time: float | None = None) -> SlaveError:
        """Return the error with the FMU's message, or with the status if it gave none."""
        self._fatal = self._fatal or status == fmi2.FATAL
        name = f"{self.prefix}{_STATUS[status]}" if 0 <= status < len(_STATUS) else f"status {status}"
        return SlaveError(self.name, self.log.complaint() or f"{what} failed with {name}; the FMU gave no reason", time)

    def free(self) -> None:
        """Terminate and free the instance; after a fatal error no FMI function may be called, so it isn't freed."""
        if not self._fatal:
            if self._initialized:
                self.fmi[f"{self.prefix}Terminate"](self.component)
            self.fmi[f"{self.prefix}FreeInstance"](self.component)
        self.component.value = None
        self.log.close()
        _alive.pop(self._fmu.folder, None)

    @property
    def alive(self) -> bool:
        """Whether FMI functions may be called: there was no fatal error."""
        return not self._fatal

    @property
    def initialized(self) -> bool:
        """Whether the FMU has been initialised, without a fatal error since."""
        return self._initialized and not self._fatal


class FmuInstance(Instance):
    """Current instance of an FMI 2.0 FMU; see `Instance`."""

    prefix = "fmi2"

    def __init__(self, fmu: UnpackedFmu, fmi: fmi2.Calls) -> None:
        super().__init__(fmu, fmi)
        self._resources = Path(fmu.folder, "resources").as_uri().encode()
        self._do_step: partial[int] = partial(fmi["fmi2DoStep"], self.component)
        self._asynchronous = bool(fmu.description.coSimulation.canRunAsynchronuously)
        self._can_go_back = bool(fmu.description.coSimulation.canGetAndSetFMUstate)

    def _created(self, name: bytes) -> int | None:
        callbacks = byref(self.log.callbacks)
        kind, instantiate = fmi2.CO_SIMULATION, self.fmi["fmi2Instantiate"]
        found: int | None = instantiate(name, kind, self._guid, self._resources, callbacks, 0, 0)
        return found

    def set_up(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set up the experiment."""
        setup = self.fmi["fmi2SetupExperiment"]
        given, relative = tolerance is not None, tolerance or 0.0
        self.check("fmi2SetupExperiment", lambda: setup(self.component, given, relative, start_time, 1, stop_time))

    def initialize(self, meanwhile: Call) -> None:
        """Enter initialisation mode, call ``meanwhile``, and exit initialisation mode."""
        self.check("initialisation", lambda: self.fmi["fmi2EnterInitializationMode"](self.component))
        meanwhile()
        self.check("initialisation", lambda: self.fmi["fmi2ExitInitializationMode"](self.component))
        self._initialized = True

    def step(self, time: float, step: float, no_rollback: int) -> None:
        status = self._do_step(time, step, no_rollback)
        if status == fmi2.PENDING and self._asynchronous:
            status = self.awaited(status)
        if status > fmi2.WARNING:
            raise self.step_error(status, time, step)

    def bound_step(self) -> BoundStep | None:
        return None if self._asynchronous else (self._do_step, self.step_error)

    def step_error(self, status: int, time: float, step: float) -> SlaveError:
        """Return the error of a failed step, with the last time that the FMU reached."""
        reached, terminated = c_double(time), c_int(0)
        component, fmi = self.component, self.fmi
        error = self.error(f"the step from {time:.9g} s by {step:.9g} s", status, time)
        if status == fmi2.PENDING and not self._asynchronous:
            said = self.log.complaint()
            return SlaveError(error.slave, f"{UNCLAIMED}; its last message: {said}" if said else UNCLAIMED, time)
        if status != fmi2.DISCARD:
            return error
        fmi["fmi2GetRealStatus"](component, fmi2.LAST_SUCCESSFUL_TIME, byref(reached))
        fmi["fmi2GetBooleanStatus"](component, fmi2.TERMINATED, byref(terminated))
        if terminated.value:
            return SlaveEnded(error.slave, self.log.complaint() or "fmi2Terminated", reached.value)
        if self._fmu.is_ours:
            return SlaveError(error.slave, error.reason, reached.value)
        # FMI 2.0, 4.2.2: a shorter step may succeed, from a state saved before the discarded step
        remedy = "step_control, which goes back and tries smaller steps"
        done = f"{reached.value - time:.9g} s of the step of {step:.9g} s are done (fmi2Discard)"
        reason = f"{error.reason}; {done}, take {remedy if self._can_go_back else 'a smaller communication step'}"
        return SlaveError(error.slave, reason, reached.value)

    def awaited(self, status: int) -> int:
        """Wait until a step that returned fmi2Pending is done; return its status."""
        pending = c_int(status)
        while pending.value == fmi2.PENDING:
            sleep(POLL)
            if (asked := self.fmi["fmi2GetStatus"](self.component, fmi2.DO_STEP_STATUS, byref(pending))) > fmi2.WARNING:
                return int(asked)
        return int(pending.value)

    def get_state(self, state: c_void_p) -> int:
        return int(self.fmi["fmi2GetFMUstate"](self.component, byref(state)))

    def set_state(self, state: c_void_p) -> int:
        return int(self.fmi["fmi2SetFMUstate"](self.component, state))

    def free_state(self, state: c_void_p) -> int:
        return int(self.fmi["fmi2FreeFMUstate"](self.component, byref(state)))


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
        if (status := self.call()) > fmi2.WARNING:
            raise self.error(status)

    def error(self, status: int) -> SlaveError:
        """Return the error of a failed call."""
        return self._instance.error(self._what, status)


class FmuStates:
    """Saved states of an instance: their memory is reused, and freed with the instance at the end of a run.

    Attributes:
        instance: the instance.
        no_rollback: 1 until a state is saved, then 0; argument of fmi2DoStep.
    """

    def __init__(self, instance: Instance) -> None:
        self.instance = instance
        self.no_rollback = 1
        self._states: list[c_void_p] = []
        self._spare: list[c_void_p] = []

    def save(self) -> object:
        """Return the complete state, in the memory of a released state if there is one."""
        state = self._spare.pop() if self._spare else c_void_p()
        try:
            self.instance.check("saving the state", lambda: self.instance.get_state(state))
        finally:
            # even after a failure, its memory must be freed at the end
            if state.value is not None and not any(each is state for each in self._states):
                self._states.append(state)
        self.no_rollback = 0
        return state

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one to be saved."""
        if isinstance(state, c_void_p) and not any(each is state for each in self._spare):
            self._spare.append(state)

    def restore(self, state: object) -> None:
        """Restore a saved state."""
        saved = cast(c_void_p, state)
        self.instance.check("restoring a state", lambda: self.instance.set_state(saved))

    def free(self) -> None:
        """Free all states and the instance; must be called only once."""
        if self.instance.alive:
            for state in self._states:
                self.instance.free_state(state)
        self.instance.free()

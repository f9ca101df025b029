"""The life of an FMU's instances, one at a time: made, checked at every call, and always freed."""

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
from flexfmu.cosim.engine.fmu.capabilities import needs, only_once_per_process
from flexfmu.cosim.engine.fmu.file import UnpackedFmu, attempt
from flexfmu.cosim.engine.fmu.log import FmuLog
from flexfmu.cosim.engine.slave import Call

StatusCall = Callable[[], int]
"""An FMI call with all its arguments bound; gives an fmi2Status."""

BoundStep = tuple["partial[int]", Callable[[int, float, float], BaseException]]
"""fmi2DoStep with its component bound, and what makes the error of a status, time and step."""

POLL = 1e-4
"""How long to wait until an FMU is asked again whether its step is done [s]."""

UNCLAIMED = (
    "fmi2DoStep returned fmi2Pending, which takes canRunAsynchronuously = true in the model description (FMI 2.0.4, section "
    "4.2.2); state it there, or export the FMU so that it completes its steps"
)
"""Why a step that goes on in the background isn't waited for."""

_STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")
"""Of FMI 2.0; those of FMI 3.0 are the same but for the last."""

_alive: dict[Path, str] = {}
"""Folder of an FMU that can be instantiated only once per process → name of its instance."""

_serial = count(1)
"""Instance names must differ within a process for FMUs that keep a table of them."""


@cache
def load_calls(fmu: UnpackedFmu) -> fmi2.Calls:
    """Load the FMU's library with fmpy, which stays loaded, and take its functions.

    Raises:
        FmuFileError: the library can't be loaded or lacks a function of its FMI version; or it ends the process that loads it, which
            another tool's library tries in a child process first.
    """
    description = fmu.description
    arguments = {
        "guid": description.guid,
        "modelIdentifier": description.coSimulation.modelIdentifier,
        "unzipDirectory": str(fmu.folder),
    }
    if fmu.is_fmi3:
        # fmpy's class for FMI 3.0 asks for the functions of all interfaces
        arguments["libraryPath"] = str(fmu.library)
    if AVAILABLE and not fmu.is_ours:
        try:
            in_child(lambda: bool(_loaded(fmu, arguments)), lambda: None, CALL_LIMIT)
        except ChildLostError as lost:
            raise FmuFileError(f"{fmu.path} is a broken FMU: loading its library, {lost}{needs(fmu)}") from lost
    library, signatures = _loaded(fmu, arguments), fmi2.FMI3_SIGNATURES if fmu.is_fmi3 else fmi2.FMI2_SIGNATURES
    calls: fmi2.Calls = attempt(fmu.path, lambda: fmi2.bound_calls(library, signatures))
    return calls


def _loaded(fmu: UnpackedFmu, arguments: Mapping[str, str]) -> Any:
    """The library as fmpy loads it.

    Raises:
        FmuFileError: it can't be loaded, with the system's reason.
    """
    try:
        return _FMU(**arguments).dll
    except Exception as error:
        # fmpy puts the library's temporary place before the reason
        reason = " ".join(str(error).replace(f"{fmu.folder}/", "").split()).partition(" shared library ")[2] or str(
            error
        )
        raise FmuFileError(
            f"{fmu.path} can't be loaded on this machine: {reason}{needs(fmu)}; install what is missing, or export it for "
            "this system"
        ) from error


class Instance(ABC):
    """The instance of an FMU that is in use, and after it the next one, of either FMI version.

    Attributes:
        component: place of the instance's handle; empty where there is none. A call that is bound to it reaches whichever
            instance there is when it is made.
        fmi: the FMI functions.
        log: what the FMU says, or said in its last life.
        name: of the slave.
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
        """Make the instance; the one before has been freed.

        Raises:
            SlaveError: the FMU refuses.
        """
        self.name, self._initialized, self._fatal = name, False, False
        if (sole := self._fmu.folder if only_once_per_process(self._fmu) else None) in _alive:
            raise SlaveError(
                name,
                f"{self._fmu.path.name} can be instantiated only once per process (canBeInstantiatedOnlyOncePerProcess = "
                f"true), and {_alive[sole]} is its instance; run one after the other, or export it for several instances",
            )
        # each name once in a process; what the FMU says goes into its log
        self.log.open()
        self.component.value = self._created(f"{name} {next(_serial)}".encode())
        if self.component.value is None:
            self.log.close()
            error = self.error("instantiation", fmi2.ERROR)
            raise SlaveError(name, error.reason + needs(self._fmu))
        if sole is not None:
            _alive[sole] = name

    @abstractmethod
    def _created(self, name: bytes) -> int | None:
        """The handle of a new instance; None where the FMU refuses."""

    @abstractmethod
    def set_up(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set up the experiment."""

    @abstractmethod
    def initialize(self, meanwhile: Call) -> None:
        """Go through initialisation mode, and do something in it."""

    @abstractmethod
    def step(self, time: float, step: float, no_rollback: int) -> None:
        """Advance from ``time`` by ``step`` [s]; without rollback no earlier state is restored.

        Raises:
            SlaveError: the FMU fails or gets through only a part of the step; carries the last time that it reached.
            SlaveEnded: it asks to end the simulation.
        """

    def bound_step(self) -> BoundStep | None:
        """Its function with its component bound, and what makes the error of a failed step; None where `step` has more to
        do than to call it."""
        return None

    @abstractmethod
    def get_state(self, state: c_void_p) -> int:
        """Save the state; the status."""

    @abstractmethod
    def set_state(self, state: c_void_p) -> int:
        """Go back to a state; the status."""

    @abstractmethod
    def free_state(self, state: c_void_p) -> int:
        """Free a saved state; the status."""

    def accepts(self, call: StatusCall) -> bool:
        """Whether the FMU goes along with a call that it may refuse.

        Raises:
            SlaveError: it ends with a fatal error.
        """
        if (status := call()) == fmi2.FATAL:
            raise self.error("a call", status)
        return status <= fmi2.WARNING

    def check(self, what: str, call: StatusCall) -> None:
        """Do something and raise what the FMU says if it fails."""
        if (status := call()) > fmi2.WARNING:
            raise self.error(what, status)

    def checked(self, what: str, call: StatusCall) -> Checked:
        """The call as one that raises what the FMU says if it fails."""
        return Checked(self, what, call)

    def error(self, what: str, status: int, time: float | None = None) -> SlaveError:
        """The error with the FMU's own words, or what there is without any."""
        self._fatal = self._fatal or status == fmi2.FATAL
        name = f"{self.prefix}{_STATUS[status]}" if 0 <= status < len(_STATUS) else f"status {status}"
        return SlaveError(self.name, self.log.complaint() or f"{what} failed with {name}; the FMU gave no reason", time)

    def free(self) -> None:
        """Terminate and free; after a fatal error nothing may be called any more, and the instance is left alone."""
        if not self._fatal:
            if self._initialized:
                self.fmi[f"{self.prefix}Terminate"](self.component)
            self.fmi[f"{self.prefix}FreeInstance"](self.component)
        self.component.value = None
        self.log.close()
        _alive.pop(self._fmu.folder, None)

    @property
    def alive(self) -> bool:
        """Whether functions may still be called."""
        return not self._fatal

    @property
    def initialized(self) -> bool:
        """Whether the FMU has been initialised and may still be called."""
        return self._initialized and not self._fatal


class FmuInstance(Instance):
    """The instance of an FMI 2.0 FMU; see `Instance`."""

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
        """Go through initialisation mode, and do something in it."""
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
        """What a failed step has to say, with the last time that the FMU reached."""
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
        # FMI 2.0, 4.2.2: a shorter step may do, but from a state saved before the one that was discarded
        remedy = "step_control, which goes back and tries smaller steps"
        done = f"{reached.value - time:.9g} s of the step of {step:.9g} s are done (fmi2Discard)"
        reason = f"{error.reason}; {done}, take {remedy if self._can_go_back else 'a smaller communication step'}"
        return SlaveError(error.slave, reason, reached.value)

    def awaited(self, status: int) -> int:
        """The status of fmi2DoStep when its step is done, which goes on in the FMU after fmi2Pending."""
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
    """A call that raises what the FMU says if it fails.

    Attributes:
        call: the FMI call.
    """

    __slots__ = ("_instance", "_what", "call")

    def __init__(self, instance: Instance, what: str, call: StatusCall) -> None:
        self.call = call
        self._instance, self._what = instance, what

    def __call__(self) -> None:
        if (status := self.call()) > fmi2.WARNING:
            raise self.error(status)

    def error(self, status: int) -> SlaveError:
        """What the FMU says about a failure."""
        return self._instance.error(self._what, status)


class FmuStates:
    """Saved states of an instance: their memory is used again, and freed with the instance at the end of a run."""

    def __init__(self, instance: Instance) -> None:
        self.instance = instance
        self.no_rollback = 1
        self._states: list[c_void_p] = []
        self._spare: list[c_void_p] = []

    def save(self) -> object:
        """The complete state, in the memory of a released one where there is any."""
        state = self._spare.pop() if self._spare else c_void_p()
        try:
            self.instance.check("saving the state", lambda: self.instance.get_state(state))
        finally:
            # whatever it points to now must be freed at the end
            if state.value is not None and not any(each is state for each in self._states):
                self._states.append(state)
        self.no_rollback = 0
        return state

    def release(self, state: object) -> None:
        """Keep the memory of a saved state for the next one."""
        if isinstance(state, c_void_p) and not any(each is state for each in self._spare):
            self._spare.append(state)

    def restore(self, state: object) -> None:
        """Go back to a saved state."""
        saved = cast(c_void_p, state)
        self.instance.check("restoring a state", lambda: self.instance.set_state(saved))

    def free(self) -> None:
        """Free states and instance; to be called once."""
        if self.instance.alive:
            for state in self._states:
                self.instance.free_state(state)
        self.instance.free()

"""The life of an FMU's instances, one at a time: made, checked at every call, and always freed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ctypes import byref, c_void_p
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

from fmpy.fmi2 import FMU2Slave

from flexfmu.cosim.errors import FmuFileError, SlaveError
from flexfmu.cosim.fmu import calls as fmi2
from flexfmu.cosim.fmu.capabilities import needs, only_once_per_process
from flexfmu.cosim.fmu.file import UnpackedFmu
from flexfmu.cosim.fmu.log import FmuLog
from flexfmu.cosim.master.isolation import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.slave import Call

StatusCall = Callable[[], int]
"""An FMI call with all its arguments bound; gives an fmi2Status."""

_STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")

_alive: dict[Path, str] = {}
"""Folder of an FMU that can be instantiated only once per process → name of its instance."""

_serial = count(1)
"""Instance names must differ within a process for FMUs that keep a table of them."""


@cache
def load_calls(fmu: UnpackedFmu) -> fmi2.Calls:
    """Load the FMU's library with fmpy, which stays loaded, and take its functions.

    Raises:
        FmuFileError: the library can't be loaded or lacks a function of FMI 2.0; or it ends the process that loads it, which
            another tool's library tries in a child process first.
    """
    description = fmu.description
    arguments = {
        "guid": description.guid,
        "modelIdentifier": description.coSimulation.modelIdentifier,
        "unzipDirectory": str(fmu.folder),
    }
    if AVAILABLE and not fmu.is_ours:
        try:
            in_child(lambda: bool(_loaded(fmu, arguments)), lambda: None, CALL_LIMIT)
        except ChildLostError as lost:
            raise FmuFileError(f"{fmu.path} is a broken FMU: loading its library, {lost}{needs(fmu)}") from lost
    return fmi2.fmi2_calls(_loaded(fmu, arguments).dll)


def _loaded(fmu: UnpackedFmu, arguments: Mapping[str, str]) -> Any:
    """The library as fmpy loads it.

    Raises:
        FmuFileError: it can't be loaded, with the system's reason.
    """
    try:
        return FMU2Slave(**arguments)
    except Exception as error:
        # fmpy puts the library's temporary place before the reason
        reason = " ".join(str(error).replace(f"{fmu.folder}/", "").split()).partition(" shared library ")[2] or str(
            error
        )
        raise FmuFileError(
            f"{fmu.path} can't be loaded on this machine: {reason}{needs(fmu)}; install what is missing, or export it for "
            "this system"
        ) from error


class FmuInstance:
    """The instance of an FMU that is in use, and after it the next one.

    Attributes:
        component: place of the instance's handle; empty where there is none. A call that is bound to it reaches whichever
            instance there is when it is made.
        fmi: the FMI functions.
        log: what the FMU says, or said in its last life.
    """

    def __init__(self, fmu: UnpackedFmu, fmi: fmi2.Calls) -> None:
        self.component = c_void_p()
        self.fmi = fmi
        self.log = FmuLog()
        self._name = ""
        self._fmu = fmu
        self._guid = fmu.description.guid.encode()
        self._resources = Path(fmu.folder, "resources").as_uri().encode()
        self._initialized = self._fatal = False

    def instantiate(self, name: str) -> None:
        """Make the instance; the one before has been freed.

        Raises:
            SlaveError: the FMU refuses.
        """
        self._name, self._initialized, self._fatal = name, False, False
        if (sole := self._fmu.folder if only_once_per_process(self._fmu) else None) in _alive:
            raise SlaveError(
                name,
                f"{self._fmu.path.name} can be instantiated only once per process (canBeInstantiatedOnlyOncePerProcess = "
                f"true), and {_alive[sole]} is its instance; run one after the other, or export it for several instances",
            )
        self.log.open()
        self.component.value = self.fmi["fmi2Instantiate"](
            f"{name} {next(_serial)}".encode(),
            fmi2.CO_SIMULATION,
            self._guid,
            self._resources,
            byref(self.log.callbacks),
            0,
            0,
        )
        if self.component.value is None:
            self.log.close()
            error = self.error("instantiation", fmi2.ERROR)
            raise SlaveError(name, error.reason + needs(self._fmu))
        if sole is not None:
            _alive[sole] = name

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

    def accepts(self, call: StatusCall) -> bool:
        """Whether the FMU goes along with a call that it may refuse.

        Raises:
            SlaveError: it ends with fmi2Fatal.
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
        name = _STATUS[status] if 0 <= status < len(_STATUS) else f"status {status}"
        return SlaveError(
            self._name, self.log.complaint() or f"{what} failed with {name}; the FMU gave no reason", time
        )

    def free(self) -> None:
        """Terminate and free; after fmi2Fatal nothing may be called any more, and the instance is left alone."""
        if not self._fatal:
            if self._initialized:
                self.fmi["fmi2Terminate"](self.component)
            self.fmi["fmi2FreeInstance"](self.component)
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


class Checked:
    """A call that raises what the FMU says if it fails.

    Attributes:
        call: the FMI call.
    """

    __slots__ = ("_instance", "_what", "call")

    def __init__(self, instance: FmuInstance, what: str, call: StatusCall) -> None:
        self.call = call
        self._instance, self._what = instance, what

    def __call__(self) -> None:
        if (status := self.call()) > fmi2.WARNING:
            raise self.error(status)

    def error(self, status: int) -> SlaveError:
        """What the FMU says about a failure."""
        return self._instance.error(self._what, status)

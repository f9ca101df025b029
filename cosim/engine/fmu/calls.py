"""The FMI 2.0 and 3.0 functions of a loaded FMU as C calls on addresses, without conversions; and the messages that it logs.

fmpy's methods convert lists to C arrays at every call; here arrays are numpy buffers whose addresses are taken once.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from ctypes import CFUNCTYPE, Structure, byref, c_bool, c_char_p, c_double, c_int, c_uint
from dataclasses import dataclass
from enum import Enum, auto
from functools import cache
from itertools import count
from typing import Any
from weakref import finalize

import numpy as np
from fmpy import calloc, free, freeLibrary
from fmpy.fmi2 import (
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import fmi3ClockUpdateCallback, fmi3LogMessageCallback
from fmpy.logging import addLoggerProxy
from numpy.typing import DTypeLike, NDArray

from flexfmu.fmu_build.c_header import TYPES, Signature, signatures
from flexfmu.fmu_build.toolchain import fmi_header_folder

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
"""Values of fmi2Status; those of fmi3Status are the same without Pending."""

DO_STEP_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED = 0, 2, 3
"""Values of fmi2StatusKind: fmi2DoStepStatus, fmi2LastSuccessfulTime, fmi2Terminated."""

INTERVAL_CHANGED = 2
"""Value fmi3IntervalChanged of fmi3IntervalQualifier."""


class FmuMode(Enum):
    """What may be done with an instance: change structural parameters, initialise, change inputs at an event, do so until the next step, or step."""

    CONFIGURATION = auto()
    INITIALIZATION = auto()
    EVENT = auto()
    OPEN_EVENT = auto()
    STEP = auto()


MODEL_EXCHANGE, CO_SIMULATION = 0, 1
"""Values fmi2ModelExchange and fmi2CoSimulation of fmi2Type."""

_TYPES: Mapping[str, Any] = {
    **TYPES,
    **dict.fromkeys(("fmi2Status", "fmi2StatusKind", "fmi2Type", "fmi2Boolean", "fmi2Integer", "fmi3Status"), c_int),
    "fmi2Real": c_double,
    "fmi3Float64": c_double,
    "fmi3Boolean": c_bool,
    **{
        f"fmi{version}{name}": kind
        for version in "23"
        for name, kind in (("String", c_char_p), ("ValueReference", c_uint))
    },
}
"""Types of FMI's headers that aren't addresses."""

_FMI3_NUMBERS: dict[str, DTypeLike] = {
    "Float32": np.float32,
    "Float64": np.float64,
    **{f"{sign}Int{bits}": np.dtype(f"{sign}Int{bits}".lower()) for bits in (8, 16, 32, 64) for sign in ("", "U")},
    "Boolean": np.bool_,
}

_EXCHANGE = (
    *("EnterEventMode", "EnterContinuousTimeMode", "SetTime", "CompletedIntegratorStep", "GetEventIndicators"),
    *("SetContinuousStates", "GetContinuousStates", "GetNominalsOfContinuousStates"),
)
"""Functions of model exchange that both versions have."""


def _event_info(flag: Any) -> type[Structure]:
    """Return the type of fmi2EventInfo; the results of fmi3UpdateDiscreteStates have the same order."""
    flags = ("again", "ends", "nominals_changed", "states_changed", "timed")
    return type("EventInfo", (Structure,), {"_fields_": [*((each, flag) for each in flags), ("time", c_double)]})


@dataclass(frozen=True)
class Version:
    """What differs between the functions of FMI 2.0 and 3.0.

    Attributes:
        prefix: start of the functions' names.
        state: what the functions call a state of the FMU.
        functions: names, without the prefix, of the functions for all interface types.
        interfaces: interface type → those for it alone.
        update: function that updates discrete states.
        rates: function that reads the derivatives of the states.
        event_info: type of the results of ``update``.
        dtypes: numeric types of variables → element types of the C arrays.
        output_derivatives: function that reads derivatives of outputs.
        counts_values: whether a transfer also takes the number of values, which arrays make larger than that of variables.
    """

    prefix: str
    state: str
    functions: Sequence[str]
    interfaces: Mapping[str, Sequence[str]]
    update: str
    rates: str
    event_info: type[Any]
    dtypes: Mapping[str, DTypeLike]
    output_derivatives: str
    counts_values: bool


FMI2 = Version(
    prefix="fmi2",
    state="FMUstate",
    functions=(
        *(
            "Instantiate",
            "FreeInstance",
            "SetupExperiment",
            "EnterInitializationMode",
            "ExitInitializationMode",
            "Terminate",
        ),
        *(f"{verb}{kind}" for kind in ("Real", "Integer", "Boolean", "String") for verb in ("Get", "Set")),
        *("GetDirectionalDerivative", "GetFMUstate", "SetFMUstate", "FreeFMUstate"),
    ),
    interfaces={
        "CoSimulation": (
            *("SetRealInputDerivatives", "GetRealOutputDerivatives", "DoStep"),
            *("GetStatus", "GetRealStatus", "GetBooleanStatus"),
        ),
        "ModelExchange": (*_EXCHANGE, "GetDerivatives", "NewDiscreteStates"),
    },
    update="NewDiscreteStates",
    rates="GetDerivatives",
    event_info=_event_info(c_int),
    dtypes={"Real": np.float64, "Integer": np.int32, "Boolean": np.int32},
    output_derivatives="fmi2GetRealOutputDerivatives",
    counts_values=False,
)
FMI3 = Version(
    prefix="fmi3",
    state="FMUState",
    functions=(
        *(
            "FreeInstance",
            "EnterInitializationMode",
            "ExitInitializationMode",
            "EnterEventMode",
            "UpdateDiscreteStates",
        ),
        *("EnterConfigurationMode", "ExitConfigurationMode", "Terminate", "GetFMUState", "SetFMUState", "FreeFMUState"),
        *(f"{verb}{kind}" for kind in (*_FMI3_NUMBERS, "String") for verb in ("Get", "Set")),
        *("GetClock", "SetClock", "SetIntervalDecimal", "GetIntervalDecimal", "GetShiftDecimal"),
    ),
    interfaces={
        "CoSimulation": ("InstantiateCoSimulation", "EnterStepMode", "DoStep", "GetOutputDerivatives"),
        "ModelExchange": (
            *(*_EXCHANGE, "InstantiateModelExchange", "GetContinuousStateDerivatives", "GetDirectionalDerivative"),
            *("GetNumberOfContinuousStates", "GetNumberOfEventIndicators"),
        ),
        "ScheduledExecution": ("InstantiateScheduledExecution", "ActivateModelPartition"),
    },
    update="UpdateDiscreteStates",
    rates="GetContinuousStateDerivatives",
    event_info=_event_info(c_bool),
    dtypes=_FMI3_NUMBERS,
    output_derivatives="fmi3GetOutputDerivatives",
    counts_values=True,
)
"""fmi2Boolean is an int, fmi3Boolean C's bool; enumerations use the functions of Integer and Int64."""

_RARE = ("String", "Derivative", "Derivatives", "Status", "FMUstate", "Clock", "Decimal")
"""Endings of the names of functions that some libraries lack, although FMI requires all."""

Calls = dict[str, Callable[..., Any]]


@cache
def _signatures(prefix: str) -> Mapping[str, Signature]:
    """Return the signatures of a version's functions, of the standard's headers."""
    header = fmi_header_folder() / f"{prefix}FunctionTypes.h"
    return signatures(header.read_text(encoding="utf-8"), _TYPES)


def bound_calls(library: Any, version: Version, kind: str) -> Calls:
    """Return the functions of an interface type from a loaded library.

    A missing function that few FMUs need (`_RARE`) is replaced by one that returns fmi2Error.

    Raises:
        AttributeError: the library lacks any other function.
    """
    calls: Calls = {}
    for each in (*version.functions, *version.interfaces[kind]):
        name = f"{version.prefix}{each}"
        prototype = CFUNCTYPE(*_signatures(version.prefix)[name])
        lacks = not hasattr(library, name) and name.endswith(_RARE)
        calls[name] = prototype(lambda *_: ERROR) if lacks else prototype((name, library))
    return calls


def close_after_use(library: Any) -> None:
    """Close a library when nothing refers to it or to one of its functions any more."""
    finalize(library, freeLibrary, library._handle).atexit = False


def address(array: NDArray[Any]) -> int:
    """Return the address of a C-contiguous array, valid while the array exists.

    Raises:
        ValueError: the array isn't C-contiguous.
    """
    if not array.flags.c_contiguous:
        raise ValueError("a buffer for FMI functions must be C-contiguous")
    return int(array.ctypes.data)


def value_references(references: list[int]) -> NDArray[np.uint32]:
    """Return value references as the array that FMI functions take."""
    return np.array(references, dtype=np.uint32)


MAXIMUM_MESSAGES = 200
"""Messages kept per instance; a verbose FMU must not fill the memory."""

MAXIMUM_COMPLAINTS = 3
"""Last messages of a failure that an error quotes."""


class FmuLog:
    """Log of one instance at a time.

    Attributes:
        messages: messages with status warning or worse, oldest first.
        callbacks: callback structure for fmi2Instantiate; must exist as long as the instance.
        receive: function of FMI 3.0 that takes messages; must exist as long as the instance.
    """

    def __init__(self) -> None:
        self.messages: list[str] = []
        self._complaints: deque[str] = deque(maxlen=MAXIMUM_COMPLAINTS)
        self._key = next(_keys)
        self.callbacks: Any = fmi2CallbackFunctions()
        self.callbacks.allocateMemory = _allocate
        self.callbacks.freeMemory = _free
        self.callbacks.componentEnvironment = self._key
        # without an environment, which not all FMUs pass on
        self.receive = fmi3LogMessageCallback(lambda environment, status, category, text: self.add(status, _text(text)))

    def open(self) -> None:
        """Clear the messages and receive those of the next instance.

        fmpy's logger proxy, which formats messages, serves one logger at a time in a process.
        """
        self.messages.clear()
        self._complaints.clear()
        _logs[self._key] = self
        self.callbacks.logger = _logger
        addLoggerProxy(byref(self.callbacks))

    def close(self) -> None:
        """Stop receiving messages."""
        _logs.pop(self._key, None)

    def complaint(self) -> str:
        """Return the last messages of a failure as one line; empty if the FMU gave none."""
        return "; ".join(dict.fromkeys(self._complaints))

    def add(self, status: int, message: str) -> None:
        """Keep a message with status warning or worse."""
        line = " ".join(message.split())
        if status >= WARNING and len(self.messages) < MAXIMUM_MESSAGES:
            self.messages.append(line)
        if status > WARNING:
            self._complaints.append(line)


_logs: dict[int, FmuLog] = {}
_keys = count(1)


def _receive(environment: int | None, name: bytes, status: int, category: bytes, message: bytes) -> None:
    """Add a message to its instance's log; print it if the instance is unknown."""
    log = _logs.get(environment or 0)
    if log is not None:
        log.add(status, _text(message))
    elif status >= WARNING:
        print(f"{_text(name)}: {_text(message)}", file=sys.stderr)


def _text(text: bytes | None) -> str:
    """Return a text of an FMU, whatever its bytes are."""
    return (text or b"").decode("utf-8", "replace")


CLOCK_UPDATE = fmi3ClockUpdateCallback(lambda key: None)
"""The function of scheduled execution that tells of clocks, which are asked after each model partition anyhow."""

_logger = fmi2CallbackLoggerTYPE(_receive)
_allocate = fmi2CallbackAllocateMemoryTYPE(calloc)
_free = fmi2CallbackFreeMemoryTYPE(free)

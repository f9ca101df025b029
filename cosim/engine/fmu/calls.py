"""The FMI 2.0 and 3.0 functions of a loaded FMU as C calls on addresses, without conversions.

fmpy's methods convert lists to C arrays at every call; here arrays are numpy buffers whose addresses are taken once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ctypes import CFUNCTYPE, c_bool, c_char_p, c_double, c_int, c_size_t, c_void_p
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
"""Values of fmi2Status; those of fmi3Status are the same without Pending."""

DO_STEP_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED = 0, 2, 3
"""Values of fmi2StatusKind: fmi2DoStepStatus, fmi2LastSuccessfulTime, fmi2Terminated."""

CO_SIMULATION = 1
"""Value fmi2CoSimulation of fmi2Type."""

Signature = tuple[Any, ...]
"""C types of the result and of the arguments; pointers are addresses."""

FMI2_SIGNATURES: dict[str, Signature] = {
    "fmi2Instantiate": (c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int),
    "fmi2FreeInstance": (None, c_void_p),
    "fmi2SetupExperiment": (c_int, c_void_p, c_int, c_double, c_double, c_int, c_double),
    **dict.fromkeys(("fmi2EnterInitializationMode", "fmi2ExitInitializationMode", "fmi2Terminate"), (c_int, c_void_p)),
    **{
        f"fmi2{verb}{kind}": (c_int, c_void_p, c_void_p, c_size_t, c_void_p)
        for kind in ("Real", "Integer", "Boolean", "String")
        for verb in ("Get", "Set")
    },
    "fmi2SetRealInputDerivatives": (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2GetRealOutputDerivatives": (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2GetDirectionalDerivative": (
        *(c_int, c_void_p, c_void_p, c_size_t),
        *(c_void_p, c_size_t, c_void_p, c_void_p),
    ),
    "fmi2DoStep": (c_int, c_void_p, c_double, c_double, c_int),
    "fmi2GetStatus": (c_int, c_void_p, c_int, c_void_p),
    "fmi2GetRealStatus": (c_int, c_void_p, c_int, c_void_p),
    "fmi2GetBooleanStatus": (c_int, c_void_p, c_int, c_void_p),
    **{f"fmi2{verb}FMUstate": (c_int, c_void_p, c_void_p) for verb in ("Get", "Set", "Free")},
}
"""Functions of FMI 2.0 → signatures."""

DTYPES: dict[str, DTypeLike] = {
    "Float32": np.float32,
    "Float64": np.float64,
    "Int8": np.int8,
    "UInt8": np.uint8,
    "Int16": np.int16,
    "UInt16": np.uint16,
    "Int32": np.int32,
    "UInt32": np.uint32,
    "Int64": np.int64,
    "UInt64": np.uint64,
    "Boolean": np.bool_,
}
"""Numeric types of FMI 3.0 → element types of the C arrays; enumerations use the functions of Int64."""

_TRANSFER: Signature = (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_size_t)

_FMI3_MODES = ("EnterConfiguration", "ExitConfiguration", "ExitInitialization", "EnterEvent", "EnterStep")

FMI3_SIGNATURES: dict[str, Signature] = {
    "fmi3InstantiateCoSimulation": (
        *(c_void_p, c_char_p, c_char_p, c_char_p, c_bool, c_bool, c_bool, c_bool),
        *(c_void_p, c_size_t, c_void_p, c_void_p, c_void_p),
    ),
    "fmi3FreeInstance": (None, c_void_p),
    **{f"fmi3{mode}Mode": (c_int, c_void_p) for mode in _FMI3_MODES},
    "fmi3EnterInitializationMode": (c_int, c_void_p, c_bool, c_double, c_double, c_bool, c_double),
    "fmi3UpdateDiscreteStates": (c_int, *[c_void_p] * 7),
    "fmi3Terminate": (c_int, c_void_p),
    "fmi3DoStep": (c_int, c_void_p, c_double, c_double, c_bool, *[c_void_p] * 4),
    "fmi3GetOutputDerivatives": (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p, c_size_t),
    **{f"fmi3{verb}FMUState": (c_int, c_void_p, c_void_p) for verb in ("Get", "Set", "Free")},
    **{f"fmi3{verb}{kind}": _TRANSFER for kind in (*DTYPES, "String") for verb in ("Get", "Set")},
}
"""Functions of FMI 3.0 → signatures; fmi3Boolean is C's bool."""

_RARE = ("String", "Derivative", "Derivatives", "Status", "FMUstate")
"""Endings of the names of functions that some libraries lack, although FMI requires all."""

Calls = dict[str, Callable[..., Any]]


def bound_calls(library: Any, signatures: Mapping[str, tuple[Any, ...]]) -> Calls:
    """Return the functions with these signatures from a loaded library.

    A missing function that few FMUs need (`_RARE`) is replaced by one that returns fmi2Error.

    Raises:
        AttributeError: the library lacks any other function.
    """
    calls: Calls = {}
    for name, signature in signatures.items():
        prototype = CFUNCTYPE(*signature)
        lacks = not hasattr(library, name) and name.endswith(_RARE)
        calls[name] = prototype(lambda *_: ERROR) if lacks else prototype((name, library))
    return calls


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

"""The FMI 2.0 functions of a loaded FMU as plain C calls on addresses, without any conversion on the way.

fmpy's methods turn lists into C arrays at every call; here arrays are numpy buffers whose addresses are taken once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ctypes import CFUNCTYPE, c_char_p, c_double, c_int, c_size_t, c_void_p
from typing import Any

import numpy as np
from numpy.typing import NDArray

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
"""fmi2Status."""

DO_STEP_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED = 0, 2, 3
"""fmi2StatusKind."""

CO_SIMULATION = 1
"""fmi2Type."""

SIGNATURES: dict[str, tuple[Any, ...]] = {
    "fmi2Instantiate": (c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_void_p, c_int, c_int),
    "fmi2FreeInstance": (None, c_void_p),
    "fmi2SetupExperiment": (c_int, c_void_p, c_int, c_double, c_double, c_int, c_double),
    "fmi2EnterInitializationMode": (c_int, c_void_p),
    "fmi2ExitInitializationMode": (c_int, c_void_p),
    "fmi2Terminate": (c_int, c_void_p),
    "fmi2GetReal": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2GetInteger": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2GetBoolean": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2GetString": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2SetReal": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2SetInteger": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2SetBoolean": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2SetString": (c_int, c_void_p, c_void_p, c_size_t, c_void_p),
    "fmi2SetRealInputDerivatives": (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2GetRealOutputDerivatives": (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p),
    "fmi2DoStep": (c_int, c_void_p, c_double, c_double, c_int),
    "fmi2GetStatus": (c_int, c_void_p, c_int, c_void_p),
    "fmi2GetRealStatus": (c_int, c_void_p, c_int, c_void_p),
    "fmi2GetBooleanStatus": (c_int, c_void_p, c_int, c_void_p),
    "fmi2GetFMUstate": (c_int, c_void_p, c_void_p),
    "fmi2SetFMUstate": (c_int, c_void_p, c_void_p),
    "fmi2FreeFMUstate": (c_int, c_void_p, c_void_p),
}
"""Function → (result, arguments); pointers as addresses."""

_RARE = ("String", "Derivatives", "Status", "FMUstate")
"""How functions end that some libraries lack, though FMI has them all."""

Calls = dict[str, Callable[..., Any]]


def bound_calls(library: Any, signatures: Mapping[str, tuple[Any, ...]]) -> Calls:
    """Functions with these signatures from a loaded library; one that few FMUs need fails when it is called where it is missing.

    Raises:
        AttributeError: the library lacks another one.
    """
    calls: Calls = {}
    for name, signature in signatures.items():
        prototype = CFUNCTYPE(*signature)
        lacks = not hasattr(library, name) and name.endswith(_RARE)
        calls[name] = prototype(lambda *_: ERROR) if lacks else prototype((name, library))
    return calls


def address(array: NDArray[Any]) -> int:
    """Address of a C-contiguous array, valid while the array lives."""
    if not array.flags.c_contiguous:
        raise ValueError("a buffer for FMI functions must be C-contiguous")
    return int(array.ctypes.data)


def value_references(references: list[int]) -> NDArray[np.uint32]:
    """Value references as FMI functions take them."""
    return np.array(references, dtype=np.uint32)

"""The FMI 3.0 functions of a loaded FMU as plain C calls on addresses; what `flexfmu.cosim.engine.fmu.calls` is for FMI 2.0."""

from __future__ import annotations

from ctypes import c_bool, c_char_p, c_double, c_int, c_size_t, c_void_p
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

Signature = tuple[Any, ...]

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
"""Types of variables that are numbers → element types of the C arrays; enumerations are reached as Int64."""

_TRANSFER: Signature = (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_size_t)

SIGNATURES: dict[str, Signature] = {
    "fmi3InstantiateCoSimulation": (
        *(c_void_p, c_char_p, c_char_p, c_char_p, c_bool, c_bool, c_bool, c_bool),
        *(c_void_p, c_size_t, c_void_p, c_void_p, c_void_p),
    ),
    "fmi3FreeInstance": (None, c_void_p),
    "fmi3EnterConfigurationMode": (c_int, c_void_p),
    "fmi3ExitConfigurationMode": (c_int, c_void_p),
    "fmi3EnterInitializationMode": (c_int, c_void_p, c_bool, c_double, c_double, c_bool, c_double),
    "fmi3ExitInitializationMode": (c_int, c_void_p),
    "fmi3EnterEventMode": (c_int, c_void_p),
    "fmi3UpdateDiscreteStates": (c_int, *[c_void_p] * 7),
    "fmi3EnterStepMode": (c_int, c_void_p),
    "fmi3Terminate": (c_int, c_void_p),
    "fmi3DoStep": (c_int, c_void_p, c_double, c_double, c_bool, *[c_void_p] * 4),
    "fmi3GetOutputDerivatives": (c_int, c_void_p, c_void_p, c_size_t, c_void_p, c_void_p, c_size_t),
    "fmi3GetFMUState": (c_int, c_void_p, c_void_p),
    "fmi3SetFMUState": (c_int, c_void_p, c_void_p),
    "fmi3FreeFMUState": (c_int, c_void_p, c_void_p),
    **{f"fmi3{verb}{kind}": _TRANSFER for kind in (*DTYPES, "String") for verb in ("Get", "Set")},
}
"""Function → (result, arguments); pointers as addresses, fmi3Boolean as C's bool."""

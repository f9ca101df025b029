"""The C library of the master: compiled once on a machine, loaded once in a process."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CDLL, POINTER, Structure, byref, c_int, c_size_t, c_void_p
from functools import cache
from typing import Any

from flexfmu.cosim.engine.master.instructions import CProgram, CProgress
from flexfmu.cosim.engine.shared_library import shared_library
from flexfmu.fmu_build.errors import BuildError

RunProgram = Callable[[CProgram, int, CProgress], int]
"""Runs a program until so many steps are completed; returns 0, or 1 if an instruction failed."""


class CDense(Structure):
    """``master_dense``."""

    _fields_ = (("count", c_size_t), ("begins", c_void_p), ("points", c_void_p), ("weights", c_void_p))


@cache
def load() -> RunProgram | None:
    """The C function that runs programs; None if it can't be compiled or loaded, for example without a C compiler."""
    if (library := _library()) is None:
        return None
    function: Any = library.master_run
    function.argtypes = (POINTER(CProgram), c_size_t, POINTER(CProgress))
    function.restype = c_int
    return lambda program, points, progress: int(function(byref(program), points, byref(progress)))


@cache
def load_interpolation() -> Callable[..., None] | None:
    """``master_interpolate``; None as for `load`."""
    if (library := _library()) is None:
        return None
    function: Any = library.master_interpolate
    function.argtypes = (POINTER(CDense), c_void_p, c_size_t, c_void_p, c_size_t, c_size_t, c_void_p)
    function.restype = None
    interpolate: Callable[..., None] = function
    return interpolate


def _library() -> CDLL | None:
    try:
        return shared_library("flexfmu.cosim.engine.master", "c-master")
    except BuildError:
        return None

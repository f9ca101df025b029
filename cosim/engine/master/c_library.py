"""The C library of the master: compiled once on a machine, loaded once in a process."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import POINTER, byref, c_int, c_size_t
from functools import cache
from typing import Any

from flexfmu.cosim.engine.master.instructions import CProgram, CProgress
from flexfmu.cosim.engine.shared_library import shared_library

RunProgram = Callable[[CProgram, int, CProgress], int]
"""Runs a program until so many steps are completed; returns 0, or 1 if an instruction failed."""


@cache
def load() -> RunProgram | None:
    """The C function that runs programs; None if it can't be compiled or loaded, for example without a C compiler."""
    library = shared_library("flexfmu.cosim.engine.master", "c-master")
    if library is None:
        return None
    function: Any = library.master_run
    function.argtypes = (POINTER(CProgram), c_size_t, POINTER(CProgress))
    function.restype = c_int
    return lambda program, points, progress: int(function(byref(program), points, byref(progress)))

"""What passes between the master and an FMU's functions, without any FMU."""

from __future__ import annotations

from ctypes import POINTER, c_int32, c_uint32, c_void_p, cast
from types import SimpleNamespace
from typing import Any

import numpy as np

from flexfmu.cosim.engine.fmu.calls import FMI2, MAXIMUM_COMPLAINTS, MAXIMUM_MESSAGES, WARNING, FmuLog
from flexfmu.cosim.engine.fmu.transfers import Transfers
from flexfmu.cosim.engine.fmu.variables import Handle


def test_integers_are_rounded() -> None:
    """What comes out of a calculation is nearly a whole number, and the nearest one is meant."""
    told: list[tuple[int, int]] = []

    def set_integer(component: c_void_p, references: int, count: int, values: int) -> int:
        names, numbers = cast(references, POINTER(c_uint32)), cast(values, POINTER(c_int32))
        told.extend((names[i], numbers[i]) for i in range(count))
        return 0

    instance: Any = SimpleNamespace(
        calls={"fmi2SetInteger": set_integer}, component=c_void_p(1), version=FMI2, name="fmu"
    )
    transfers = Transfers(instance)
    handles = [Handle("Integer", 7, "Integer"), Handle("Integer", 9, "Integer")]
    assert transfers.set(handles, np.array([2.9999999999, -1.0000000001]))() == 0
    assert told == [(7, 3), (9, -1)]


def test_a_chatty_fmu_does_not_fill_the_memory() -> None:
    """The first messages and the last complaints are kept."""
    log = FmuLog()
    try:
        for i in range(1000):
            log.add(WARNING + 1, f"step  {i}\nfailed")
    finally:
        log.close()
    assert len(log.messages) == MAXIMUM_MESSAGES < 1000
    assert log.messages[0] == "step 0 failed"
    assert log.complaint() == "; ".join(f"step {i} failed" for i in range(1000 - MAXIMUM_COMPLAINTS, 1000))

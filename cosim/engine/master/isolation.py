"""Which runs are simulated in a child process: those with code from elsewhere.

The child records into memory that it shares with its parent, which looks on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass

from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.slave import Slave


@dataclass(frozen=True)
class Isolation:
    """How runs are isolated.

    Attributes:
        call_limit: how long a slave may stay in one call [s].
    """

    call_limit: float = CALL_LIMIT


def isolation(wanted: bool | None, slaves: Iterable[Slave], call_limit: float, *, theirs: bool) -> Isolation | None:
    """How a run of these slaves is isolated; None for a run in this process.

    Args:
        wanted: what the user says; None for isolation where slaves are from elsewhere.
        slaves: the slaves.
        call_limit: how long a slave may stay in one call [s].
        theirs: whether Python slaves are the caller's own objects, which the caller may read after the run.

    Raises:
        InputError: isolation is wanted on a platform that doesn't have it.
    """
    if wanted and not AVAILABLE:
        raise InputError(
            f"isolate = true needs Linux, this is {sys.platform}: leave `isolate` out to run all slaves in this process"
        )
    # slaves from elsewhere, but not objects whose owner may read them afterwards
    if wanted is None:
        foreign = [slave for slave in slaves if is_foreign(slave)]
        objects = theirs and any(not hasattr(slave, "path") for slave in foreign)
        wanted = AVAILABLE and bool(foreign) and not objects
    return Isolation(call_limit) if wanted else None


def is_foreign(slave: Slave) -> bool:
    """Whether a slave runs code that isn't ours: an FMU of another tool, or a Python class from elsewhere."""
    if isinstance(slave, FmuSlave | SampledFmu | FmuTask):
        return not open_fmu(slave.path).is_ours
    return not type(slave).__module__.startswith("flexfmu.")

"""Decides which runs are simulated in a child process: those with foreign code.

The child records into memory that it shares with its parent, which watches its progress.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

from flexfmu.cosim.engine.child_process import AVAILABLE
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.sampled_slave import FmuTask, SampledFmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.slave import Slave


def isolation(wanted: bool | None, slaves: Iterable[Slave], call_limit: float, *, caller_owned: bool) -> float | None:
    """The call limit [s] of a run of these slaves in a child process; None for a run in this process.

    Args:
        wanted: the user's choice; None isolates runs with foreign slaves, where the platform allows it.
        slaves: the slaves.
        call_limit: longest duration of one call of a slave [s].
        caller_owned: whether Python slaves are the caller's own objects, which the caller may read after the run; if
            ``wanted`` is None, such a run stays in this process.

    Raises:
        InputError: isolation is wanted on a platform other than Linux.
    """
    if wanted and not AVAILABLE:
        raise InputError(
            f"isolate = true needs Linux, this is {sys.platform}: leave `isolate` out to run all slaves in this process"
        )
    # isolate foreign slaves, but not objects that the caller may read after the run
    if wanted is None:
        foreign = [slave for slave in slaves if is_foreign(slave)]
        objects = caller_owned and any(not (hasattr(slave, "path") or hasattr(slave, "block")) for slave in foreign)
        wanted = AVAILABLE and bool(foreign) and not objects
    return call_limit if wanted else None


def is_foreign(slave: Slave) -> bool:
    """Whether a slave runs foreign code: an FMU of another tool, a Python class outside this package, or a user's function."""
    if isinstance(slave, FmuSlave | SampledFmu | FmuTask):
        return not open_fmu(slave.path).is_ours
    return getattr(slave, "has_foreign_code", False) or not type(slave).__module__.startswith("flexfmu.")

"""Whether a reset, a saved state and a neighbour leave everything as it was, to the last bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from flexfmu.fmu_build.checks.fmu import FmuUnderTest
from flexfmu.fmu_build.finding import Finding

FRACTIONS = (0.0, 0.25, 0.75)
"""Parts of the default experiment at which states are saved."""

OTHER_PROCESS_TIMEOUT = 60.0
"""Longest wait for a process that replays a state [s]."""


def repeats_after_reset(fmu: FmuUnderTest) -> Finding | None:
    """fmi2Reset brings back the state after instantiation, all of it."""
    with fmu.instance("reset") as instance:
        first = instance.run()
        instance.reset()
        second = instance.run()
    return _compare("reset", first, second, "after fmi2Reset", "fmi2Reset has to restore everything, starts included")


def replays_saved_states(fmu: FmuUnderTest) -> Finding | None:
    """States contain everything that the future depends on, in whatever order they are used."""
    if not fmu.can_save:
        return None
    marks = [round(fraction * fmu.steps) for fraction in FRACTIONS]
    with fmu.instance("save") as instance:
        instance.initialize()
        states = []
        for mark, end in zip(marks, [*marks[1:], fmu.steps], strict=True):
            states.append(instance.save())
            instance.advance(mark, end)
        futures: dict[int, NDArray[np.float64]] = {}
        for turn in (0, 1):
            for mark, state in list(zip(marks, states, strict=True))[:: 1 - 2 * turn]:
                instance.restore(state)
                rows = instance.advance(mark, fmu.steps)
                finding = _compare(
                    "state", futures.setdefault(mark, rows), rows, "after fmi2SetFMUstate", _STATE_REMEDY
                )
                if finding is not None:
                    return finding
        for state in states:
            instance.discard(state)
    return None


def replays_serialized_state(fmu: FmuUnderTest) -> Finding | None:
    """A serialised state works in another instance and in another process."""
    if not fmu.can_serialize:
        return None
    half = fmu.steps // 2
    with fmu.instance("writer") as writer:
        writer.initialize()
        writer.advance(0, half)
        data = writer.serialize()
        rows = writer.advance(half, fmu.steps)
    with fmu.instance("reader") as reader:
        reader.initialize()
        reader.restore_serialized(data)
        again = reader.advance(half, fmu.steps)
    what = "with a serialised state in another instance"
    finding = _compare("serialisation", rows, again, what, _STATE_REMEDY)
    if finding is not None:
        return finding
    return _compare(
        "serialisation",
        rows,
        _replay_elsewhere(fmu, data),
        "with a serialised state in another process",
        "serialised states must hold values, no addresses",
    )


def continue_from(fmu: FmuUnderTest, data: bytes) -> NDArray[np.float64]:
    """The second half of the default experiment from a serialised state."""
    with fmu.instance("other process") as instance:
        instance.initialize()
        instance.restore_serialized(data)
        return np.asarray(instance.advance(fmu.steps // 2, fmu.steps))


def _replay_elsewhere(fmu: FmuUnderTest, data: bytes) -> NDArray[np.float64]:
    """`continue_from` in a new process.

    Raises:
        RuntimeError: it ends in another way than it should.
    """
    with TemporaryDirectory(prefix="flexfmu-replay-") as home:
        state, result = Path(home) / "state", Path(home) / "rows.npy"
        state.write_bytes(data)
        module = "flexfmu.fmu_build.checks.elsewhere"
        command = [sys.executable, "-m", module, str(fmu.folder), fmu.kind.name, str(fmu.maximum_steps)]
        outcome = subprocess.run(
            [*command, str(state), str(result)], capture_output=True, timeout=OTHER_PROCESS_TIMEOUT, check=False
        )
        if outcome.returncode != 0 or not result.exists():
            last = (outcome.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise RuntimeError(f"a serialised state in another process ends it with {outcome.returncode}: {last}")
        rows: NDArray[np.float64] = np.load(result)
        return rows


def two_instances_are_independent(fmu: FmuUnderTest) -> Finding | None:
    """Two instances that take turns do what one alone does."""
    if not fmu.can_have_two:
        return None
    with fmu.instance("alone") as instance:
        alone = instance.run()
    with fmu.instance("one") as one, fmu.instance("two") as two:
        one.initialize()
        two.initialize()
        turns = [(one.advance(n, n + 1), two.advance(n, n + 1)) for n in range(fmu.steps)]
    together = (np.vstack([turn[which] for turn in turns]) for which in (0, 1))
    remedy = "keep all data in the instance, none in static variables"
    findings = (_compare("instances", alone, rows, "with two instances at once", remedy) for rows in together)
    return next((finding for finding in findings if finding), None)


_STATE_REMEDY = "the state must hold everything that the future depends on: internal variables, inputs, time"


def _compare(
    check: str, first: NDArray[np.float64], second: NDArray[np.float64], when: str, remedy: str
) -> Finding | None:
    """A finding if two recordings differ at all: the arithmetic is the same, so the results must be."""
    if np.array_equal(first, second, equal_nan=True):
        return None
    difference = np.nanmax(np.abs(first - second))
    return Finding(check, f"outputs differ by up to {difference:.3g} {when}; they should be identical", remedy)

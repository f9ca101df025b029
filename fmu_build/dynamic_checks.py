"""A short life of an FMU: run as a program of its own, it prints its findings as JSON.

python -m flexfmu.fmu_build.dynamic_checks FILE.fmu
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import fmpy
import numpy as np
from fmpy.model_description import read_model_description
from numpy.typing import NDArray

from flexfmu.fmu_build.finding import REPORT, Finding
from flexfmu.fmu_build.fmu_instance import FmuUnderTest

MAXIMUM_STEPS = 2000
"""Communication steps of the default experiment that are made at most."""

Check = Callable[[FmuUnderTest], str | None]


def check_dynamically(path: Path) -> list[Finding]:
    """Findings of all checks; a check that the FMU cannot take part in is left out."""
    folder = Path(fmpy.extract(str(path)))
    try:
        fmu = FmuUnderTest(read_model_description(str(path)), folder, MAXIMUM_STEPS)
        problem = _outcome(instantiates, fmu)
        if problem is not None:
            return [Finding("instantiation", problem)]
        outcomes = ((name, _outcome(check, fmu)) for name, check in CHECKS.items())
        return [Finding(name, message) for name, message in outcomes if message is not None]
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def instantiates(fmu: FmuUnderTest) -> str | None:
    """An instance can be made, and the binary speaks FMI 2.0; nothing else makes sense without."""
    with fmu.instance("version") as instance:
        version, types = instance.version()
    return None if (version, types) == ("2.0", "default") else f"says version {version}, types platform {types}"


def refuses_wrong_guid(fmu: FmuUnderTest) -> str | None:
    """A binary must not run with somebody else's description."""
    with suppress(Exception), fmu.instance("wrong_guid", guid="{00000000-0000-0000-0000-000000000000}"):
        return "fmi2Instantiate accepts a wrong GUID"
    return None


def outputs_are_finite(fmu: FmuUnderTest) -> str | None:
    """The default experiment with all inputs at their start values."""
    with fmu.instance("finite") as instance:
        outputs = instance.run()
    bad = np.argwhere(~np.isfinite(outputs))
    if not bad.size:
        return None
    row, column = map(int, bad[0])
    return f"output {fmu.output_names[column]} is {outputs[row, column]} at {fmu.start + (row + 1) * fmu.step:.6g} s"


def repeats_after_reset(fmu: FmuUnderTest) -> str | None:
    """fmi2Reset brings back the state after instantiation, all of it."""
    with fmu.instance("reset") as instance:
        first = instance.run()
        instance.reset()
        second = instance.run()
    return _compare(first, second, "a reset")


def replays_saved_state(fmu: FmuUnderTest) -> str | None:
    """A saved state contains everything that the future depends on."""
    if not fmu.can_save:
        return None
    with fmu.instance("save") as instance:
        instance.initialize()
        half = fmu.steps // 2
        instance.advance(0, half)
        state = instance.save()
        first = instance.advance(half, fmu.steps)
        instance.restore(state)
        second = instance.advance(half, fmu.steps)
        instance.discard(state)
    return _compare(first, second, "restoring a saved state")


def replays_serialized_state(fmu: FmuUnderTest) -> str | None:
    """A serialised state works in another instance."""
    if not fmu.can_serialize or not fmu.can_have_two:
        return None
    half = fmu.steps // 2
    with fmu.instance("writer") as writer, fmu.instance("reader") as reader:
        writer.initialize()
        writer.advance(0, half)
        data = writer.serialize()
        reader.initialize()
        reader.restore_serialized(data)
        return _compare(
            writer.advance(half, fmu.steps), reader.advance(half, fmu.steps), "passing a serialised state on"
        )


def two_instances_are_independent(fmu: FmuUnderTest) -> str | None:
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
    problems = (_compare(alone, outputs, "running two instances at once") for outputs in together)
    return next((problem for problem in problems if problem), None)


CHECKS: dict[str, Check] = {
    "guid": refuses_wrong_guid,
    "simulation": outputs_are_finite,
    "reset": repeats_after_reset,
    "state": replays_saved_state,
    "serialisation": replays_serialized_state,
    "instances": two_instances_are_independent,
}
"""Name of the finding → check of an FMU that `instantiates`; a check gives a sentence, or None if all is well."""


def _outcome(check: Check, fmu: FmuUnderTest) -> str | None:
    try:
        return check(fmu)
    except Exception as error:  # any failed FMI call is a finding, not the end of the validation
        logged = f" ({fmu.messages[-1]})" if fmu.messages else ""
        return f"{' '.join(str(error).split())}{logged}"
    finally:
        fmu.messages.clear()


def _compare(first: NDArray[np.float64], second: NDArray[np.float64], after: str) -> str | None:
    """A sentence if two recordings differ at all: the arithmetic is the same, so the results must be."""
    if np.array_equal(first, second, equal_nan=True):
        return None
    return f"outputs differ by up to {np.nanmax(np.abs(first - second)):.3g} after {after}; they should be identical"


def main() -> None:
    """Check the FMU named on the command line."""
    print(REPORT + json.dumps([asdict(finding) for finding in check_dynamically(Path(sys.argv[1]))]))


if __name__ == "__main__":
    main()

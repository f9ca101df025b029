"""Through which files a number passes on its way: the payload's mass from the scene to C, a joint reference to `doStep`, a controller's
torque to the robot. A file counts if one of its functions gets or returns the very number, alone or in a list, table or array.

    python benchmarks/walks.py
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, MappingProxyType
from typing import Any

import numpy as np

import flexfmu

ROOT = Path(flexfmu.__file__).parents[2]
DEEP, MANY = 3, 400
"""How deep nested values are searched, and how many of each."""

BACK = ("cosim/engine/master/recorder.py", "cosim/engine/master/outcome.py", "cosim/experiment/run_checks.py")
"""Files that the number passes on its way back, in what is recorded."""


def holds(value: Any, number: float, depth: int = 0) -> bool:
    """Whether a value is the number, or has it."""
    if isinstance(value, float):
        return value == number
    if isinstance(value, np.ndarray):
        return value.dtype == float and bool((value == number).any())
    if depth == DEEP:
        return False
    if isinstance(value, dict | MappingProxyType):
        value = [*value.values()]
    if isinstance(value, list | tuple):
        return any(holds(each, number, depth + 1) for each in value[:MANY])
    return False


@contextmanager
def watched(number: float) -> Iterator[dict[str, set[str]]]:
    """Files, with their functions, that get or return the number meanwhile."""
    found: dict[str, set[str]] = {}

    def look(frame: FrameType, event: str, result: Any) -> None:
        path = frame.f_code.co_filename
        if not path.startswith(str(ROOT)) or ".venv" in path or "benchmarks" in path or event not in ("call", "return"):
            return
        values = frame.f_locals.values() if event == "call" else [result]
        if any(holds(each, number) for each in values):
            found.setdefault(str(Path(path).relative_to(ROOT)), set()).add(frame.f_code.co_name)

    sys.setprofile(look)
    try:
        yield found
    finally:
        sys.setprofile(None)


def payload_mass() -> tuple[float, Callable[[], object]]:
    """A mass that occurs nowhere else, as a parameter of a cached FMU."""
    scene = flexfmu.load_scene("barnard2012-6kg").replace({"payload.mass": 6.123})
    flexfmu.build(scene)
    return 6.123, lambda: flexfmu.run(flexfmu.load_scene("barnard2012-6kg").replace({"payload.mass": 6.123}))


def joint_reference() -> tuple[float, Callable[[], object]]:
    """The first joint's angle at the start."""
    scene = flexfmu.load_scene("barnard2012-6kg")
    start = float(flexfmu.run(scene).recording["joint1.reference.position"].values[0])
    return start, lambda: flexfmu.run(scene)


def controller_torque() -> tuple[float, Callable[[], object]]:
    """What a controller in Python commands."""
    number = 7.4321

    @flexfmu.controller(sample_time=1e-3, symbolic=False)
    def constant(t: float, reference: Any, measurement: Any, state: Any) -> Any:
        return [number, 0.1], state

    robot = flexfmu.load_scene("barnard2012-6kg").replace(
        {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "trajectory.dwell": 0.0}
    )
    return number, lambda: flexfmu.run(robot, controllers=[constant])


def main() -> None:
    """Print each walk."""
    for prepare in (payload_mass, joint_reference, controller_torque):
        number, run = prepare()
        with watched(number) as found:
            run()
        way = {file: names for file, names in sorted(found.items()) if file not in BACK}
        print(f"{prepare.__name__}: {len(way)} files")
        for file, names in way.items():
            print(f"    {file}: {', '.join(sorted(names)[:4])}")


if __name__ == "__main__":
    main()

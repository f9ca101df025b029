"""What the command line and a build cost: processor times of whole processes, with those that they start, imports included. Used by
`speed.py`; not a script of its own.

A scene is built where the cache has only the objects of the runtime, which are compiled once for a machine and a compiler: they are
there after the FMU of a rigid robot. The other line of `speed.py` has neither.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from paper_scene import SCENE
from speed_figure import SpeedFigure

from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.fmu_build.cache import FOLDER_VARIABLE

PROCESSES = 3
"""Of which the fastest counts."""

RIGID = {"effects.proximal_bending": 0, "effects.distal_axial": 0}


BYTECODE = Path(tempfile.gettempdir()) / "flexfmu-speed-bytecode"
"""Where these processes keep it, whatever the environment says."""


def command_line_figures() -> Iterator[SpeedFigure]:
    """Help, runs of a scene whose FMU is in the cache, and a build."""
    with tempfile.TemporaryDirectory(prefix="flexfmu-speed-") as name:
        folder = Path(name)
        for arguments, target in (
            (("--help",), 0.15),
            (("run", "--help"), 0.15),
            (("run", SCENE.name, "--report"), 0.8),
            (("run", SCENE.name, "--json"), 0.4),
        ):
            _process_time(folder, arguments)
            value = min(_process_time(folder, arguments) for _ in range(PROCESSES))
            yield SpeedFigure(
                f"flexfmu {' '.join(arguments)}", value, target, "s", note="whole process, FMU in the cache"
            )
    note = "whole process of flexfmu build; runtime compiled before"
    yield SpeedFigure("build of the FMU", min(_build_time() for _ in range(PROCESSES - 1)), 2.5, "s", note=note)


def _build_time() -> float:
    """Return the processor time [s] of a build with an empty cache but for the runtime's objects."""
    with tempfile.TemporaryDirectory(prefix="flexfmu-speed-") as name:
        folder = Path(name)
        before = os.environ.get(FOLDER_VARIABLE)
        os.environ[FOLDER_VARIABLE] = name
        try:
            build_scene(SCENE.replace(RIGID))
        finally:
            if before is None:
                del os.environ[FOLDER_VARIABLE]
            else:
                os.environ[FOLDER_VARIABLE] = before
        return _process_time(folder, ("build", SCENE.name), {FOLDER_VARIABLE: name})


def _process_time(folder: Path, arguments: tuple[str, ...], environment: dict[str, str] | None = None) -> float:
    """Return the processor time [s] of a command and of the processes that it starts, Python's bytecode being cached."""
    command = (sys.executable, "-m", "flexfmu", *arguments)
    variables = {**os.environ, "PYTHONPYCACHEPREFIX": str(BYTECODE), **(environment or {})}
    variables.pop("PYTHONDONTWRITEBYTECODE", None)
    before = os.times()
    subprocess.run(command, cwd=folder, env=variables, check=True, capture_output=True)
    return sum(os.times()[2:4]) - sum(before[2:4])

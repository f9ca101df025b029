"""The loop in C: every instruction under the address and undefined-behaviour sanitizers, and the numbers of the loop in Python."""

from __future__ import annotations

import shutil
import subprocess
from importlib.resources import as_file, files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flexfmu.cosim.engine.master.compiled_loop import load
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.shared_library import shared_library
from flexfmu.cosim.experiment import scene_build
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.system import scene_system
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SOURCES = Path(__file__).parent / "c-master"


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize(
    ("source", "tested", "arguments"),
    [("program.c", "master.c", []), ("program.c", "master.c", ["step"]), ("dense_program.c", "dense.c", [])],
    ids=["not finite", "failed step", "interpolation"],
)
def test_programs(source: str, tested: str, arguments: list[str], tmp_path: Path) -> None:
    """What all instructions write, when they are carried out, and where a failure is reported; all derivatives of two
    signals, at a point and between the last ones."""
    program = tmp_path / "program"
    with as_file(files("flexfmu.cosim.engine.master") / "c-master") as folder:
        command = [COMPILER, *FLAGS, *SANITIZERS, "-I", folder, SOURCES / source, folder / tested, "-o", program]
        built = subprocess.run([str(each) for each in command], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    outcome = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


SCENE = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.2, "trajectory.dwell": 0.02})

CONTROLLED = SCENE.replace(
    {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "controller": [
            {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 5e-4},
            {"kind": "feedforward", "sample_time": 1e-3},
        ],
        "shaper": [{"kind": "zv", "apply": "sampled", "sample_time": 1e-3, "modes": [{"frequency": 58.0}]}],
        "imperfection": [
            {"kind": "encoder", "counts_per_turn": 1e6},
            {"kind": "noise", "signal": "torque", "standard_deviation": 0.1},
            {"kind": "lag", "time_constant": 3e-4},
        ],
    }
)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SCENE, CONTROLLED], ids=["motion-driven", "controlled"])
def test_the_same_numbers(scene: Scene) -> None:
    """Every signal and derivative at every instant, with streamed references and with sampled slaves of all kinds; it is
    also the second run of the same slaves, which repeats the first to the last bit."""
    loop = loop_of(scene, plan(scene))
    parts = scene_system(scene, loop, build_scene(scene).path)
    system = connect(parts.slaves, parts.wiring.connections)
    found, exact = (
        simulate(system, loop.motion.stop_time, 5e-4, tolerance=1e-6, compiled=each).recording for each in (True, False)
    )
    assert found.time.size > 400
    np.testing.assert_array_equal(found.time, exact.time)
    assert list(found.columns) == list(exact.columns)
    for name, column in found.columns.items():
        for part in ("values", "first", "second"):
            np.testing.assert_array_equal(getattr(column, part), getattr(exact[name], part), name)


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The run goes on in Python; a scene's FMU brings the C libraries into the cache, where they need no compiler."""
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path / "built"))
    monkeypatch.setattr(scene_build, "build_fmu", lambda *_, **__: SimpleNamespace(cached=False))
    build_scene(SCENE)
    monkeypatch.setenv("CC", "there-is-no-such-compiler")
    assert load.__wrapped__() is not None
    assert shared_library("metrics").metrics_peak
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path / "empty"))
    assert load.__wrapped__() is None

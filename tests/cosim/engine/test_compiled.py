"""The loop over the communication points in C does what the loop in Python does, number by number and error by error."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flexfmu.cosim.engine.master.compiled_loop import load
from flexfmu.cosim.engine.master.simulator import Outcome, Simulation, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.shared_library import shared_library
from flexfmu.cosim.experiment import scene_build
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of
from flexfmu.cosim.experiment.system import scene_system
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

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


def both(scene: Scene, loop: Loop | None = None) -> tuple[Simulation, Simulation]:
    """The scene in C and in Python."""
    loop = loop_of(scene, plan(scene)) if loop is None else loop
    parts = scene_system(scene, loop, build_scene(scene).path)
    system = connect(parts.slaves, parts.wiring.connections)
    runs = [simulate(system, loop.motion.stop_time, 5e-4, tolerance=1e-6, compiled=each) for each in (True, False)]
    return runs[0], runs[1]


def assert_identical(first: Simulation, second: Simulation) -> None:
    """To the last bit."""
    assert (first.outcome, first.message) == (second.outcome, second.message)
    assert np.array_equal(first.recording.time, second.recording.time)
    assert list(first.recording.columns) == list(second.recording.columns)
    for name, column in first.recording.columns.items():
        other = second.recording[name]
        for mine, its in ((column.values, other.values), (column.first, other.first), (column.second, other.second)):
            assert (mine is None) == (its is None)
            if mine is not None and its is not None:
                assert np.array_equal(mine, its), name


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SCENE, CONTROLLED], ids=["motion-driven", "controlled"])
def test_the_same_numbers(scene: Scene) -> None:
    """Every signal and derivative at every instant, with streamed references and with sampled slaves of all kinds; it is
    also the second run of the same slaves, which repeats the first to the last bit."""
    compiled, interpreted = both(scene)
    assert compiled.outcome is Outcome.COMPLETED
    assert compiled.recording.time.size > 400
    assert_identical(compiled, interpreted)


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

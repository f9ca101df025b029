"""One FMU serves all scenes that differ in values of its parameters and in the motion, and gives what their own FMUs give, to the last bit."""

from __future__ import annotations

import gc
import shutil
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexfmu import load_scene
from flexfmu.cosim.engine.fmu.file import KEPT, _unpacked
from flexfmu.cosim.engine.fmu.instance import load_calls
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.experiment.scene_build import build_scene, shared_key
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.fmu_build import build

ROBOT = load_scene("barnard2012-6kg").replace({"trajectory.dwell": 0.02, "cosimulation.step": 1e-3})
DRIVEN = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.01}
OTHER = {
    "payload.mass": 2.5,
    "trajectory.duration": 0.5,
    "trajectory.start": [-0.17, 0.33],
    "mechanism.distal.length": 0.4,
    "mechanism.material.density": 2800.0,
    "effects.gravity": [0.0, -3.0],
    "effects.damping.ratio": 0.1,
}


BEAMS = {"effects.beam": "timoshenko", "effects.basis": "craig-bampton"}
SAME_LINKS = {key: value for key, value in OTHER.items() if not key.startswith("mechanism")}


@pytest.mark.parametrize(("kind", "other"), [
    pytest.param({}, OTHER, id="motion"),
    pytest.param(DRIVEN, OTHER, id="torque", marks=pytest.mark.slow),
    pytest.param({"effects.basis": "craig-bampton"}, OTHER, id="craig-bampton", marks=pytest.mark.slow),
    pytest.param(BEAMS, SAME_LINKS, id="timoshenko", marks=pytest.mark.slow),
])  # fmt: skip
def test_results_are_those_of_the_own_fmu(kind: dict[str, Any], other: dict[str, Any]) -> None:
    """Signals and metrics, by the FMU that the first scene of its kind has built."""
    first = run_scene(ROBOT.replace(kind))
    scene = ROBOT.replace({**kind, **other})
    shared, own = run_scene(scene), run_scene(scene, fmu_path=build_scene(scene).path)
    assert shared.fmu_path == first.fmu_path != own.fmu_path
    assert shared.message == own.message
    for name, column in own.recording.columns.items():
        np.testing.assert_array_equal(shared.recording.columns[name].values, column.values)
    assert {name: each.value for name, each in shared.metrics.items()} == {
        name: each.value for name, each in own.metrics.items()
    }


def test_other_values_build_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forty scenes of other payloads, lengths and durations run by one FMU: none builds, loads or unpacks another one."""
    path = run_scene(ROBOT).fmu_path
    unpacked, loaded = len(_unpacked), load_calls.cache_info().currsize

    def refuse(*arguments: object) -> bytes:
        raise AssertionError("an FMU was built")

    monkeypatch.setattr(build, "_build", refuse)
    for i in range(1, 41):
        changes = {
            "payload.mass": 0.1 * i,
            "trajectory.duration": 0.4 + 0.01 * i,
            "mechanism.proximal.length": 0.24 + 1e-4 * i,
        }
        assert run_scene(ROBOT.replace(changes)).fmu_path == path
    assert (len(_unpacked), load_calls.cache_info().currsize) == (unpacked, loaded)


@pytest.mark.parametrize("changes", [
    {"payload.mass": 0.0},
    {"effects.gravity": [0.0, 0.0]},
    {"effects.proximal_bending": 2},
    {"name": "another"},
    DRIVEN,
])  # fmt: skip
def test_other_structures_have_their_own(changes: dict[str, Any]) -> None:
    """What a value of zero leaves out, modes, name and drive are in the generated C."""
    assert shared_key(ROBOT.replace(changes)) != shared_key(ROBOT)


def test_shapes_that_depend_on_values_are_not_shared() -> None:
    """The shapes of Timoshenko's beams are numbers in the generated C."""
    beams = ROBOT.replace({"effects.beam": "timoshenko"})
    assert shared_key(beams) != shared_key(beams.replace({"mechanism.proximal.diameter": 0.036}))
    assert shared_key(beams) == shared_key(beams.replace({"payload.mass": 2.0}))


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_fmus_leave_with_their_last_slave(tmp_path: Path) -> None:
    """Of many FMUs the last ones are kept; the others leave the disk and the memory, but for one that a slave still has."""
    original, slaves, folders = run_scene(ROBOT).fmu_path, list[FmuSlave](), list[Path]()
    for i in range(KEPT + 8):
        path = shutil.copy(original, tmp_path / f"{i}.fmu")
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("extra", str(i))
        slaves = [*slaves[:1], FmuSlave(path)]
        folders.append(slaves[-1]._fmu.folder)
    gc.collect()
    mapped = Path("/proc/self/maps").read_text()
    there = [True, *[False] * 7, *[True] * KEPT]
    assert [each.is_dir() for each in folders] == [f"{each}/" in mapped for each in folders] == there
    slaves[0].initialize(0.0, 1.0, None)
    slaves[0].step(0.0, 1e-3)
    slaves[0].terminate()

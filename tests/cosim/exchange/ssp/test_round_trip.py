"""A scene that left as an SSP file comes back as the same system, and the file conforms to SSP 1.0."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssv

from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.exchange.ssp.export import PARAMETERS, export_ssp
from flexfmu.cosim.exchange.ssp.loading import load_ssp
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

pytestmark = pytest.mark.slow

SceneOf = Callable[[str], Scene]
SspOf = Callable[[str], Path]

TIGHT = 1e-11
"""Of the magnitude of a signal: what passes between the slaves and the end effector's motion differ by what the trajectory's
FMU differs from the trajectory, 1e-12 or so."""

DERIVED = 1e-9
"""Of the magnitude of recorded derivatives, which magnify that."""

TOUCH = 1e-12
"""Relative change of the payload that is to the robot what the trajectory's FMU is to the trajectory."""

SENSITIVITY = 5.0
"""How many times the effect of that change is granted: Newton iterations end early in stiff coordinates, and magnify last digits of
whatever goes in, by up to 1e6 in their fourth derivatives."""


@pytest.mark.parametrize("name", ["motion", "controlled", "drive", "furnished"])
def test_the_file_runs_as_its_scene_does(name: str, scene_of: SceneOf, ssp_of: SspOf) -> None:
    """Same instants, same signals: derivatives are streamed, blocks are sampled at their own instants, all slaves are there, and the
    payload error too."""
    scene = scene_of(name)
    loaded, expected = load_ssp(ssp_of(name)), run_scene(scene)
    touched = run_scene(scene.replace({"payload.mass": scene.payload.mass * (1.0 + TOUCH)})).recording
    assert loaded.ignored == ()
    assert [each.name for each in loaded.system.slaves] == [each.name for each in expected.slaves]
    simulation = loaded.simulate()
    assert simulation.outcome is expected.outcome is Outcome.COMPLETED, simulation.message
    np.testing.assert_allclose(simulation.recording.time, expected.recording.time, rtol=0.0, atol=1e-12)
    assert len(simulation.recording.columns) > 50
    for signal, column in simulation.recording.columns.items():
        reference = expected.recording[signal]
        assert column.unit == reference.unit
        each_order = zip(derivatives(column), derivatives(reference), derivatives(touched[signal]), strict=True)
        for order, (again, values, changed) in enumerate(each_order):
            allowed = (TIGHT if order == 0 else DERIVED) * max(abs(values).max(), 1e-9)
            # torques and the end effector's acceleration have the accelerations of the stiff coordinates in them
            if order > 0 or any(part in signal for part in ("link", "torque", "acceleration")):
                allowed += SENSITIVITY * abs(changed - values).max()
            np.testing.assert_allclose(again, values, rtol=0.0, atol=allowed, err_msg=f"{signal}, derivative {order}")


def test_signals_are_called_as_in_the_scene(scene_of: SceneOf, ssp_of: SspOf) -> None:
    """One name in the scene's recording, in that of its SSP file and in the FMUs; the names in the file are found, too."""
    loaded, expected = load_ssp(ssp_of("controlled"), stop=0.01), run_scene(scene_of("controlled")).recording
    recording = loaded.simulate().recording
    assert {*recording.columns} == {each for each in expected.columns if not each.startswith("end_effector.reference")}
    (plant,) = (slave for slave in loaded.system.slaves if slave.name == "plant")
    assert {each.name for each in plant.variables if each.causality == "output"} <= set(recording.columns)
    assert recording["plant.joint1.position"] is recording["joint1.position"]
    assert recording.units["joint1.torque"] == expected.units["joint1.torque"] == "N.m"
    with pytest.raises(KeyError, match=r"no signal 'plant\.joint3\.position' was recorded"):
        recording["plant.joint3.position"]


def derivatives(column: Column) -> list[np.ndarray]:
    """The values, and the derivatives that were recorded."""
    return [each for each in (column.values, column.first, column.second) if each is not None]


def test_parameters_are_the_robots(ssp_of: SspOf) -> None:
    """The payload error reaches the robot, in the parameter set and in the FMU itself, and nothing else."""
    values = {each.name: each for each in read_ssv(ssp_of("controlled"), resource=PARAMETERS).parameters}
    payload = values["plant.payload.mass"]
    assert (payload.type, float(payload.value), payload.unit) == ("Real", pytest.approx(6.6), "kg")
    loaded = load_ssp(ssp_of("controlled"))
    start = {each.name: each.start for each in loaded.system.slaves[1].variables}
    assert start["payload.mass"] == pytest.approx(6.6)


def test_the_same_scene_gives_the_same_bytes(scene_of: SceneOf, ssp_of: SspOf, tmp_path: Path) -> None:
    """Neither times nor folders get in."""
    again = export_ssp(scene_of("motion"), tmp_path / "deep" / "er" / "again.ssp")
    assert again.read_bytes() == ssp_of("motion").read_bytes()
    with zipfile.ZipFile(again) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_names_and_times_in_the_file(tmp_path: Path) -> None:
    """Stop time, step and tolerance are the scene's; a shipped scene's name has a hyphen, which OMSimulator refuses."""
    scene = load_scene("barnard2012-6kg").replace({"trajectory.dwell": 0.0})
    loaded = load_ssp(export_ssp(scene, tmp_path / "robot.ssp"))
    assert loaded.structure.name == "barnard2012_6kg"
    assert all(each.name.isidentifier() for each in loaded.structure.components)
    section = scene.cosimulation
    assert (loaded.start, loaded.stop, loaded.step) == (0.0, scene.trajectory.duration, section.step)
    assert loaded.tolerance == section.tolerance
    other = load_ssp(tmp_path / "robot.ssp", start=0.1, stop=0.2, step=1e-3)
    assert (other.start, other.stop, other.step) == (0.1, 0.2, 1e-3)


def test_a_torque_driven_robot_without_controller_is_held(scene_of: SceneOf, tmp_path: Path) -> None:
    """The torques that hold the start pose are in the parameter set: inputs that nothing feeds keep them."""
    scene = scene_of("controlled").replace({"controller": [], "shaper": [], "imperfection": []})
    simulation = load_ssp(export_ssp(scene, tmp_path / "held.ssp"), stop=0.02).simulate()
    x = simulation.recording["end_effector.position.x"].values
    assert simulation.outcome is Outcome.COMPLETED
    assert np.ptp(x) < 1e-9
    expected = run_scene(scene).recording
    own = {name for name in expected.columns if not name.startswith("end_effector.reference")}
    assert set(simulation.recording.columns) == own
    assert simulation.recording["joint1.torque"].values[-1] == expected["joint1.torque"].values[-1] != 0.0


def test_a_continuous_lag_leaves_as_a_sampled_one(scene_of: SceneOf, tmp_path: Path) -> None:
    """The end effector is off by what half a sample of a tenth of the time constant makes, as the page says."""
    lag = {"kind": "lag", "time_constant": 2e-4}
    controller = scene_of("controlled").controller[:1]
    scene = scene_of("controlled").replace({"controller": controller, "shaper": [], "imperfection": [lag]})
    found, expected = load_ssp(export_ssp(scene, tmp_path / "lag.ssp")).simulate().recording, run_scene(scene).recording
    x = np.interp(expected.time, found.time, found["end_effector.position.x"].values)
    assert abs(x - expected["end_effector.position.x"].values).max() == pytest.approx(2.6e-6, rel=0.1)

"""All slaves of a scene leave as FMUs, and the system of these FMUs moves as the scene does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import FmuTrajectory, TrajectorySlave
from flexfmu.cosim.exchange.slave_export import ExportedSystem, export_slaves
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

PD = {"kind": "pd", "proportional": 5e3, "derivative": 60.0, "sample_time": 5e-4}


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A controlled robot with a shaper, an encoder and a payload that nobody knows of."""
    return load_scene("barnard2012-6kg").replace(
        {
            "cosimulation.drive": "torque",
            "cosimulation.step": 1e-3,
            "effects.motor_inertia": 0.1,
            "controller": [PD],
            "shaper": [{"kind": "zv", "apply": "sampled", "sample_time": 5e-4}],
            "imperfection": [
                {"kind": "encoder", "counts_per_turn": 1e5},
                {"kind": "payload-error", "relative": 0.1},
                {"kind": "lag", "time_constant": 2e-4, "sample_time": 5e-4},
            ],
        }
    )


@pytest.fixture(scope="module")
def exported(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> ExportedSystem:
    """Its FMUs."""
    return export_slaves(scene, tmp_path_factory.mktemp("fmus"))


def test_every_slave_has_an_fmu(exported: ExportedSystem) -> None:
    """Named after the slaves; the robot's has the scene's payload and is told of the true one."""
    names = ["trajectory", "plant", "pd", "shaper", "encoder", "lag"]
    assert [each.name for each in exported.slaves] == names
    assert [each.path.name for each in exported.slaves] == [f"{name}.fmu" for name in names]
    assert {each.name: each.parameters for each in exported.slaves if each.parameters} == {
        "plant": {"payload.mass": pytest.approx(6.6)}
    }
    assert ("pd.joint1.torque", "lag.joint1.torque.input") in exported.connections


def test_the_fmus_move_as_the_scene(scene: Scene, exported: ExportedSystem) -> None:
    """The same joint angles from FMUs alone, wired as the export says."""
    expected = run_scene(scene)
    assert expected.completed, expected.message
    trajectory, plant, *others = exported.slaves
    slaves: list[Any] = [
        TrajectorySlave(FmuTrajectory(trajectory.path)),
        FmuSlave(plant.path, plant.name, plant.parameters),
        *(fmu_slave(each.path, each.name, each.parameters) for each in others),
    ]
    simulation = simulate(connect(slaves, exported.connections), exported.stop_time, exported.step, tolerance=1e-6)
    assert simulation.outcome is Outcome.COMPLETED, simulation.message
    for joint in (1, 2):
        found = simulation.recording[f"plant.joint{joint}.position"].values
        np.testing.assert_allclose(found, expected.recording[f"joint{joint}.position"].values, rtol=0.0, atol=1e-9)


def test_one_slave_alone(scene: Scene, tmp_path: Path) -> None:
    """Chosen by name, with no connections to what isn't there; a name that isn't there is answered with those that are."""
    system = export_slaves(scene, tmp_path / "new", names=["pd"])
    assert [each.name for each in system.slaves] == ["pd"]
    assert system.connections == ()
    assert [each.name for each in (tmp_path / "new").iterdir()] == ["pd.fmu"]
    with pytest.raises(InputError, match="no slave 'pid' in this scene; slaves: trajectory, plant, pd, shaper"):
        export_slaves(scene, tmp_path, names=["pid"])


class Constant(PythonSlave):
    """A torque."""

    name = "mine"
    variables = (SlaveVariable("joint1.torque", "output", "N.m", 0.0),)


def test_python_classes_stay(scene: Scene, tmp_path: Path) -> None:
    """A class of the user's own has no equations: it is named before anything is written."""
    own = scene.replace({"controller": [Constant()], "imperfection": []})
    with pytest.raises(InputError, match=r"slave 'mine' is a Constant in Python .* SymbolicBlock"):
        export_slaves(own, tmp_path / "none")
    assert not (tmp_path / "none").exists()

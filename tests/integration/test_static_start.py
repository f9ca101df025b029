"""The static start in the FMU itself, through plain fmpy."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np
import pytest

from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.statics import static_equilibrium


@pytest.mark.parametrize("drive", ["motion", "torque"])
def test_the_fmu_finds_the_equilibrium_that_the_model_finds(drive: str, tmp_path: Path) -> None:
    """At rest nothing moves, and the end effector hangs where the Python model says, also at another start pose."""
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.drive": drive})
    path = build_fmu(lambda: build_model(scene), output=tmp_path / "plant.fmu").path
    for start in (scene.trajectory.start, (0.05, 0.3)):
        values = {"start.x": start[0], "start.y": start[1]}
        result = fmpy.simulate_fmu(str(path), stop_time=0.01, output_interval=1e-3, start_values=values)
        expected = static_equilibrium(scene, motor_angles(scene.mechanism, start)).position
        for axis in (0, 1):
            np.testing.assert_allclose(result[f"end_effector.position.{'xy'[axis]}"], expected[axis], atol=1e-12)


def test_an_acceleration_at_the_start_loads_the_motion_not_its_equilibrium(tmp_path: Path) -> None:
    """Motion profiles that jump at t = 0 start from rest: the deflection there is that of gravity alone."""
    scene = load_scene("barnard2012-6kg")
    path = build_fmu(lambda: build_model(scene), output=tmp_path / "plant.fmu").path
    result = fmpy.simulate_fmu(
        str(path), stop_time=1e-4, output_interval=1e-4, start_values={"joint1.reference.acceleration": 100.0}
    )
    at_rest = static_equilibrium(scene, motor_angles(scene.mechanism, scene.trajectory.start))
    assert result["link11.bending[1]"][0] == pytest.approx(at_rest.elastic[0], rel=1e-9)
    assert abs(result["der(link11.bending[1],2)"][0]) > 1.0

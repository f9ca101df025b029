"""Gains for a bandwidth: the poles of rigid joints, and loops of the flexible robot that settle."""

from __future__ import annotations

import json
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.gains.starts import joint_inertias, started
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.file import load_scene

ROBOT = {
    "effects.proximal_bending": 1,
    "effects.distal_axial": 0,
    "trajectory.duration": 0.2,
    "trajectory.dwell": 0.05,
    "cosimulation.step": 1e-3,
    "cosimulation.tolerance": 1e-4,
    "cosimulation.drive": "torque",
}
PD = {"kind": "pd", "proportional": 5e3, "derivative": 20.0, "sample_time": 5e-4}
SCENE = load_scene("barnard2012-6kg").replace(
    {**ROBOT, "controller": [PD, {"kind": "feedforward", "sample_time": 5e-4}]}
)
W = 2.0 * pi * 10.0


def test_inertias_are_those_of_payload_and_motors() -> None:
    """Without mass of links a motor adds its inertia, and a payload its mass times the squares of the end effector's rates."""
    mechanism = {"mechanism.material.density": 1e-3, "payload.mass": 2.0}
    light = SCENE.replace({**mechanism, "controller": []})
    bare, driven, heavy = (
        joint_inertias(light.replace(each), "start")
        for each in ({}, {"effects.motor_inertia": 0.3}, {"payload.mass": 4.0})
    )
    np.testing.assert_allclose(driven - bare, 0.3, rtol=1e-9)
    np.testing.assert_allclose(heavy, 2.0 * bare, rtol=1e-4)


@pytest.mark.parametrize(
    ("kind", "poles"),
    [
        ("pd", [-W, -W]),
        ("pid", [-W, -W, -W]),
        # x3 + x2 + x/2 + 1/16 = 0 in units of 4 w
        ("cascade", (4.0 * W * np.roots([1.0, 1.0, 0.5, 0.0625])).tolist()),
    ],
)
def test_rigid_joints_have_the_poles_of_the_table(kind: Any, poles: list[complex]) -> None:
    """The characteristic polynomial of J q'' = torque with the gains, to their five digits."""
    inertia, table = joint_inertias(SCENE), flexfmu.start_gains(SCENE, kind, 10.0)
    for i, J in enumerate(inertia):
        if kind == "cascade":
            k_v = table["position"]["proportional"]
            k_p, k_i = (table["velocity"][name][i] for name in ("proportional", "integral"))
            polynomial = [J, k_p, k_p * k_v + k_i, k_i * k_v]
        else:
            polynomial = [J, *(table[name][i] for name in ("derivative", "proportional", "integral") if name in table)]
        np.testing.assert_allclose(polynomial, J * np.real(np.poly(poles)), rtol=3e-5)
    # a robot that motion drives so far has those of the same robot driven by torques, with a sample time of its own
    other = SCENE.replace({"cosimulation.drive": "motion", "controller": []})
    assert flexfmu.start_gains(other, kind, 10.0, sample_time=5e-4) == table


@pytest.mark.slow
def test_the_flexible_robot_settles_with_them() -> None:
    """With the rigid torques added each kind tracks within 3 mrad at 8 Hz."""
    robot = SCENE.replace({"effects.motor_inertia": 0.1})
    for kind in ("pd", "pid", "cascade"):
        run = flexfmu.run(started(robot, kind, 8.0))  # type: ignore[arg-type]
        assert run.completed
        assert len(run.scene.controller) == 2
        assert float(run.metrics["rms_tracking_error_1"]) < 3e-3, kind


@pytest.mark.slow
def test_tuning_begins_with_them(tmp_path: Path) -> None:
    """The tuned file has the cascade, its tuned gain, and the feedforward that was there; it is better than the start."""
    source = tmp_path / "loop.toml"
    command = "tune barnard2012-6kg --start cascade:8 --over cascade.velocity.kp=20:200 --trials 6 --json"
    options = ["--out", str(tmp_path / "out"), "-o", str(source)]
    for key, value in {**ROBOT, "effects.motor_inertia": 0.1}.items():
        options += ["--set", f"{key}={value}"]
    options += ["--set", "controller=[{kind='feedforward',sample_time=1e-3}]"]
    result = CliRunner().invoke(app, command.split() + options)
    assert result.exit_code == 0, result.output
    data, scene = json.loads(result.stdout), load_scene(source)
    assert [each.kind for each in scene.controller] == ["cascade", "feedforward"]
    assert data["minimise"]["tuned"] <= data["minimise"]["given"]
    found: Any = scene.controller[0]
    assert found.position.proportional[0] == pytest.approx(2.0 * pi * 8.0, rel=1e-4)
    assert data["keys"]["cascade.velocity.kp"]["tuned"] in (None, found.velocity.proportional[0])


@pytest.mark.parametrize(
    ("kind", "bandwidth", "more", "message"),
    [
        ("lqg", 10.0, {}, "no gains to start from for 'lqg'; choose from pd, pid, cascade"),
        ("pd", 0.0, {}, "a bandwidth must be positive, got 0 Hz"),
        ("pd", float("nan"), {}, "a bandwidth must be positive, got nan Hz"),
        ("pd", 10.0, {"pose": "top"}, "there is no pose 'top'"),
    ],
)
def test_wrong_wishes(kind: Any, bandwidth: float, more: dict[str, Any], message: str) -> None:
    """One sentence."""
    with pytest.raises(InputError, match=message):
        flexfmu.start_gains(SCENE, kind, bandwidth, **more)

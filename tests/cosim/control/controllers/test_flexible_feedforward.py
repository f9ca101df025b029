"""Torques of the flexible robot as feedforward: mean torques of the samples, and what remains of the tracking error."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import feedforward
from scipy.integrate import fixed_quad

import flexfmu
from flexfmu.cosim.control import controllers
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.computed_torque import mean_torques
from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.file import load_scene

SAMPLE_TIME = 2e-3


def test_torques_of_stiff_links_are_means_of_the_rigid_inverse_dynamics() -> None:
    scene = load_scene("barnard2012-6kg").replace(
        {
            # what bends falls with 1 / E; wide corners, as the narrow ones of the given path ring even then
            "mechanism.material.youngs_modulus": 1e14,
            "effects.proximal_bending": 1,
            "effects.distal_axial": 1,
            "trajectory.blend": {"kind": "polar", "height": 0.025, "width": 0.1},
        }
    )
    joints = plan(scene).joints
    rigid = inverse_dynamics(scene)

    def torque(time: np.ndarray) -> np.ndarray:
        q, v, a = joints.evaluate(np.minimum(time, joints.duration), 2, "left").swapaxes(1, 2)
        return np.asarray(rigid(q, v, np.where(time > joints.duration, 0.0, a)))

    found = mean_torques(scene, joints, 0.44, SAMPLE_TIME, offset=0.01)
    expected = [
        fixed_quad(torque, t, t + SAMPLE_TIME, n=6)[0] / SAMPLE_TIME for t in 0.01 + SAMPLE_TIME * np.arange(215)
    ]
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_the_block_gives_the_torques_in_turn_and_holds_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    torques = np.random.default_rng(0).normal(size=(5, 2))
    monkeypatch.setattr(controllers.computed_torque, "mean_torques", lambda *arguments, **timing: torques)
    path = plan(load_scene("barnard2012-6kg")).joints
    slave = BlockSlave(feedforward("flexible", path=path, sample_time=SAMPLE_TIME, offset=SAMPLE_TIME), "ahead")
    slave.initialize(0.0, 1.0, 1e-6)
    found = []
    for k in range(8):
        slave.sample(k * SAMPLE_TIME)
        values = np.empty(2)
        slave.get(np.array([0, 1]), values)
        found.append(values)
    np.testing.assert_array_equal(found, torques[[0, 1, 2, 3, 4, 4, 4, 4]])


@pytest.mark.parametrize(("sample_time", "better"), [(1e-3, 5.0), pytest.param(2.5e-4, 50.0, marks=pytest.mark.slow)])
def test_motors_follow_their_references_better_than_with_the_rigid_torques(sample_time: float, better: float) -> None:
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
    pd = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": sample_time}
    errors = {}
    for robot in ("rigid", "flexible"):
        ahead = {"kind": "feedforward", "robot": robot, "sample_time": sample_time}
        run = flexfmu.run(scene.replace({"controller": [pd, ahead]}))
        errors[robot] = float(run.metrics["peak_tracking_error_1"])
    assert errors["flexible"] < errors["rigid"] / better


def test_references_for_the_flexible_robot_leave_no_vibration_in_a_loop() -> None:
    pd = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
    ahead = {"kind": "feedforward", "robot": "flexible", "sample_time": 1e-3}
    scene = load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
    scene = scene.replace({"trajectory.references": "flexible", "controller": [pd, ahead]})
    run = flexfmu.run(scene)
    assert float(run.metrics["residual_vibration_amplitude"]) < 1e-6
    # 0.1 ms of lag at 80 mm/s leave 9 µm
    assert float(run.metrics["peak_position_error"]) < 2e-5

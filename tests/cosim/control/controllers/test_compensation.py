"""Feedforwards of single effects and of the flexible robot, and the disturbance observer: closed forms, a loop simulated by hand, and what
remains of the tracking error."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
import pytest
from blocks import disturbance_observer, feedforward, friction_compensation, gravity_feedforward, responses
from numpy.typing import NDArray
from scipy.integrate import fixed_quad

import flexfmu
from flexfmu.cosim.control import controllers
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.computed_torque import mean_torques
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.assembly import elbows, motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

Array = NDArray[np.float64]

H = 1e-3
JOINTS = ("joint1", "joint2")
SCENE = load_scene("barnard2012-6kg")


def scene_with(**sections: Any) -> Scene:
    """The paper's robot, driven by torques."""
    return SCENE.replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, **sections})


@pytest.mark.parametrize("motion", ["reference", "measured"])
def test_friction_compensation_is_the_friction_of_the_robot(motion: str) -> None:
    """What inverse dynamics with smooth friction have more than those without, at any rate."""
    friction = {"viscous": 1.3, "coulomb": 2.5, "velocity": 0.05}
    scene = scene_with(**{"effects.joint_friction": friction})
    section = {"kind": "friction-compensation", "motion": motion, "sample_time": H}
    (slave, _) = loop_of(scene.replace({"controller": [section, {"kind": "pd", **PD}]})).controllers[:2]
    rates = np.random.default_rng(3).normal(scale=0.2, size=(40, 2))
    place = "reference.velocity" if motion == "reference" else "velocity"
    found = responses(slave.block, {f"{joint}.{place}": rates[:, i] for i, joint in enumerate(JOINTS)})  # type: ignore[attr-defined]
    q, zero = motor_angles(SCENE.mechanism, (0.05, 0.3)), [0.0, 0.0]
    with_friction, without = (inverse_dynamics(each) for each in (scene, scene_with()))
    for k, rate in enumerate(rates):
        expected = (with_friction(q, rate, zero) - without(q, rate, zero)).full().ravel()
        torque = [found[f"{joint}.feedforward"][k] for joint in JOINTS]
        np.testing.assert_allclose(torque, expected, rtol=0.0, atol=1e-12)


def test_gravity_feedforward_is_virtual_work() -> None:
    """The gradient of the potential energy of links and payload: their weights times the change of their heights."""
    m = SCENE.mechanism
    weights = {
        name: 9.81 * m.material.density * pi / 4.0 * link.diameter**2 * link.length
        for name, link in (("proximal", m.proximal), ("distal", m.distal))
    }

    def energy(position: Array) -> float:
        heights = [elbow[1] for elbow in elbows(m, (position[0], position[1]))]
        proximal, distal = (0.5 * sum(heights), 0.5 * sum(heights) + position[1])
        return weights["proximal"] * proximal + weights["distal"] * distal + 9.81 * SCENE.payload.mass * position[1]

    def slopes(function: Callable[[Array], Any], position: Array) -> Array:
        """Derivatives by differences of fourth order."""
        h, columns = 1e-3, []
        for each in h * np.eye(2):
            far, near = (np.subtract(function(position + k * each), function(position - k * each)) for k in (2, 1))
            columns.append((8.0 * near - far) / (12.0 * h))
        return np.array(columns)

    block = gravity_feedforward(sample_time=H)
    for position in (np.array([0.05, 0.3]), np.array([-0.175, 0.32]), np.array([0.1, 0.35])):
        angles = motor_angles(m, (position[0], position[1]))
        found = responses(block, {f"{joint}.reference.position": [q] for joint, q in zip(JOINTS, angles, strict=True)})
        turned = slopes(lambda x: np.array(motor_angles(m, (x[0], x[1]))), position)
        expected = np.linalg.solve(turned, slopes(energy, position))
        torque = [found[f"{joint}.feedforward"][0] for joint in JOINTS]
        np.testing.assert_allclose(torque, expected, rtol=1e-9)


def test_observer_finds_a_constant_disturbance() -> None:
    """-d (1 - exp(-k h / T)), whatever the torques are; within its limits."""
    inertia, disturbance, time_constant, count = 0.2, 3.0, 0.01, 60
    torque = np.random.default_rng(4).normal(scale=20.0, size=count)
    # a held torque changes the rate in proportion
    rate = np.concatenate([[0.4], 0.4 + H * np.cumsum(torque[:-1] + disturbance) / inertia])
    signals = {"joint1.velocity": rate, "joint1.torque": torque}
    fading = 1.0 - np.exp(-np.arange(count) * H / time_constant)
    block = disturbance_observer(time_constant, inertia, sample_time=H)
    np.testing.assert_allclose(
        responses(block, signals)["joint1.feedforward"], -disturbance * fading, rtol=0, atol=1e-12
    )
    limited = disturbance_observer(time_constant, inertia, sample_time=H, torque_limit=2.0)
    found = responses(limited, signals)["joint1.feedforward"]
    np.testing.assert_allclose(found, np.maximum(-disturbance * fading, -2.0), rtol=0, atol=1e-12)
    assert block.feedthrough["joint1.feedforward"] == ("joint1.velocity",)


def test_observer_with_the_robot_as_its_model() -> None:
    """Torques of inverse dynamics at the mean motion need none; what is added to them is found, with the sign turned."""
    dynamics, k = inverse_dynamics(SCENE), np.arange(50)
    start = np.array(motor_angles(SCENE.mechanism, (0.0, 0.32)))
    q = start + 0.1 * np.column_stack([np.sin(0.1 * k), np.cos(0.07 * k) - 1.0])
    v = np.column_stack([np.cos(0.1 * k), -np.sin(0.07 * k)])
    means = [0.5 * (each[1:] + each[:-1]) for each in (q, v)]
    held = [dynamics(a, b, c).full().ravel() for a, b, c in zip(*means, np.diff(v, axis=0) / H, strict=True)]
    torque = np.add([*held, held[-1]], [2.0, -1.0])
    signals = {f"{joint}.position": q[:, i] for i, joint in enumerate(JOINTS)}
    signals |= {f"{joint}.velocity": v[:, i] for i, joint in enumerate(JOINTS)}
    signals |= {f"{joint}.torque": torque[:, i] for i, joint in enumerate(JOINTS)}
    found = responses(disturbance_observer(5e-3, sample_time=H), signals)
    for joint, extra in zip(JOINTS, (2.0, -1.0), strict=True):
        expected = extra * (1.0 - np.exp(-k * H / 5e-3))
        np.testing.assert_allclose(found[f"{joint}.feedforward"], expected, rtol=0.0, atol=1e-12 * abs(torque).max())


PD: dict[str, Any] = {"proportional": 1e3, "derivative": 10.0, "sample_time": H}


def test_sections_of_a_scene() -> None:
    """Coefficients, payloads and models of the scene, unless the section has its own."""
    kinds: dict[str, dict[str, Any]] = {
        "friction-compensation": {"viscous": 0.5, "coulomb": [1.0, 2.0]},
        "gravity-feedforward": {"motion": "measured", "payload": 0.0},
        "disturbance-observer": {"time_constant": 0.01, "inertia": 0.2, "torque_limit": 30.0},
    }
    tables = [{"kind": kind, "sample_time": H, **keys} for kind, keys in kinds.items()]
    friction, gravity, observer, _, total = loop_of(scene_with(controller=[*tables, {"kind": "pd", **PD}])).controllers
    starts = {each.name: each.start for each in friction.variables if each.causality == "parameter"}
    coulomb = {"joint1.coulomb_friction": 1.0, "joint2.coulomb_friction": 2.0}
    assert starts == coulomb | dict.fromkeys(("joint1.viscous_friction", "joint2.viscous_friction"), 0.5)
    assert [each.name for each in gravity.variables][:2] == ["joint1.position", "joint2.position"]
    assert {"joint1.inertia", "joint1.time_constant", "joint1.torque.maximum"} < {
        each.name for each in observer.variables
    }
    assert total.name == "feedforward_sum"


def test_there_must_be_friction() -> None:
    """A compensation of nothing is a mistake."""
    with pytest.raises(InputError, match="friction_compensation has no friction to compensate"):
        friction_compensation(sample_time=H)


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

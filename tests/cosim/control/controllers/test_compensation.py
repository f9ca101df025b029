"""Feedforwards of single effects, and the disturbance observer: closed forms, a loop simulated by hand."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
import pytest
from blocks import disturbance_observer, friction_compensation, gravity_feedforward, responses
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError
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

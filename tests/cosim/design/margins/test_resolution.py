"""The torque of one count is that of the controllers themselves, and where it is large the robot rattles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.design.margins.loop_warnings import _steps, coarse_counts, torque_of_step
from flexfmu.cosim.design.margins.scene_loop import WiredLoop
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

EXAMPLE = Path(__file__).parents[4] / "examples" / "controller_scene.toml"
PD = {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}


@pytest.fixture(scope="module")
def robot() -> Scene:
    """The example without shaper, feedforward and friction, of which the linear loop has none."""
    friction = {"effects.joint_friction.viscous": 0.0, "effects.joint_friction.coulomb": 0.0}
    return load_scene(EXAMPLE).replace({"shaper": [], "controller": [PD], "imperfection": [], **friction})


def with_encoder(robot: Scene, counts: float, window: int = 1, *more: dict[str, Any], **changes: Any) -> Scene:
    """The robot with encoders, and with more imperfections."""
    encoder = {"kind": "encoder", "counts_per_turn": counts, "window": window}
    return robot.replace({"imperfection": [encoder, *more], **changes})


def torques_of_counts(scene: Scene) -> np.ndarray[Any, Any]:
    """The torques (2,) of one count of each joint (2,) about rest at the start."""
    loop = loop_of(scene, about_rest=True)
    wired = WiredLoop(scene, loop)
    linear, _ = wired.at(scene.trajectory.start)
    return np.array([torque_of_step(linear, *step[:3]) for step in _steps(wired)])


def test_pd_and_pid(robot: Scene) -> None:
    """Drawn gains, counts, windows and rates: kp q + kd q / (w h), which a delay doesn't change, and a weak integral hardly."""
    random = np.random.default_rng(5)
    for kind in ("pd", "pd", "pd", "pid"):
        counts, kp, kd = 10.0 ** random.uniform((3.0, 2.0, 0.0), (6.0, 5.0, 3.0))
        window, sample = int(random.integers(1, 5)), float(random.choice([2.5e-4, 5e-4, 1e-3]))
        controller = {"kind": kind, "proportional": kp, "derivative": kd, "sample_time": sample}
        if kind == "pid":
            # which takes the difference of the angles itself
            controller["integral"], window = 1e-6 * kp / sample, 1
        delay = {"kind": "delay", "signal": "torque", "time": 3.0 * sample}
        found = torques_of_counts(with_encoder(robot, counts, window, delay, controller=[controller]))
        q = 2.0 * np.pi / counts
        expected = kp * q + kd * q / (window * sample)
        assert np.diag(found) == pytest.approx([expected] * 2, rel=1e-9 if kind == "pd" else 1e-3)
        assert found[0, 1] == found[1, 0] == 0.0


def test_computed_torque(robot: Scene) -> None:
    """The mass matrix of the rigid robot turns the acceleration of one count into torques of both joints."""
    controller = {"kind": "computed-torque", "proportional": 6400.0, "derivative": 160.0, "sample_time": 1e-3}
    found = torques_of_counts(with_encoder(robot, 1e5, controller=[controller]))
    angles, dynamics = np.array(motor_angles(robot.mechanism, robot.trajectory.start)), inverse_dynamics(robot)
    columns = [dynamics(angles, np.zeros(2), unit) - dynamics(angles, np.zeros(2), np.zeros(2)) for unit in np.eye(2)]
    mass = np.hstack([np.asarray(each.full()) for each in columns])
    q = 2.0 * np.pi / 1e5
    # a count's velocity also turns the Coriolis forces, which are of second order
    assert found == pytest.approx(abs(mass).T * (6400.0 * q + 160.0 * q / 1e-3), rel=1e-3)


def test_limits(robot: Scene) -> None:
    """The share is that of the smallest limit: of the controller, a saturation, the motor behind its gear, else of the motion."""
    count = 55.0 * 2.0 * np.pi / 4000.0 * 1e3
    motor = {"continuous_torque": 3.0, "peak_torque": 8.0, "maximum_speed": 100.0, "gear_ratio": 100.0}
    limited, saturation = [PD | {"torque_limit": 300.0}], {"kind": "saturation", "limit": 250.0}
    for text, scene in (
        ("the torque limit, 300 N·m", with_encoder(robot, 4e3, controller=limited)),
        ("the torque limit, 250 N·m", with_encoder(robot, 4e3, 1, saturation, controller=limited)),
        ("the torque limit, 800 N·m", with_encoder(robot, 4e3, motor=motor)),
        ("the largest torque that the motion needs", with_encoder(robot, 4e3)),
    ):
        loop = loop_of(scene, about_rest=True)
        sentence = coarse_counts(scene, loop, WiredLoop(scene, loop)) or ""
        assert text in sentence
        assert f"is {count:.3g} N·m of joint" in sentence


@pytest.mark.slow
@pytest.mark.parametrize(("counts", "coarse"), [(4e3, True), (1e6, False)])
def test_who_rattles_is_told(robot: Scene, counts: float, coarse: bool) -> None:
    """4,000 counts: the joints' velocities rattle at rest, where the margins alone see a stable loop; 1e6 counts: neither."""
    scene = with_encoder(robot, counts, **{"trajectory.dwell": 0.2})
    run, result = flexfmu.run(scene), flexfmu.margins(scene, poses=1)
    late = run.recording.time > run.plan.stop_time - 0.1
    rattle = max(abs(run.recording[f"joint{j}.velocity"].values[late]).max() for j in (1, 2))
    assert (rattle > 0.3) if coarse else (rattle < 0.03)
    told = any("one count of encoder (1.57 mrad" in each for each in run.health.messages)
    assert told is (result.coarse_counts is not None) is coarse
    assert result.is_stable

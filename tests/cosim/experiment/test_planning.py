"""From the scene's keys to the planned motion."""

from __future__ import annotations

import re

import numpy as np
import pytest

from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.trajectory import TaskTrajectory


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The paper's scene with 6 kg."""
    return load_scene("barnard2012-6kg")


def test_the_papers_motion(scene: Scene) -> None:
    """The motion starts and ends where the paper's does, over a path of its Table 11's length, and lasts as long."""
    motion = plan(scene)
    ends = motion.task.evaluate([0.0, 0.43], order=0)[0]
    np.testing.assert_allclose(ends, [[-0.175, 0.320], [0.175, 0.320]], atol=1e-12)
    assert motion.profiled.path.length == pytest.approx(0.38431, abs=5e-6)
    assert (motion.duration, motion.stop_time) == (0.43, 0.43 + 0.25)


def test_joints_follow_the_end_effector(scene: Scene) -> None:
    """Forward kinematics of the planned joint angles gives the planned end-effector position: |X - E_i| is the distal
    length, E_i being the elbows."""
    motion = plan(scene)
    time = np.linspace(0.0, 0.43, 50)
    position, angles = motion.task.evaluate(time, 0)[0], motion.joints.evaluate(time, 0)[0]
    for leg, side in enumerate((-1.0, 1.0)):
        elbow = np.stack([side * 0.1 + 0.24 * np.cos(angles[:, leg]), 0.24 * np.sin(angles[:, leg])], axis=1)
        np.testing.assert_allclose(np.linalg.norm(position - elbow, axis=1), 0.38079, rtol=1e-12)


@pytest.mark.parametrize("blend", ["lame", "clothoid", "polar"])
@pytest.mark.parametrize(("profile", "jumps"), [
    ({"kind": "poly7"}, ()),
    ({"kind": "poly5"}, ()),
    ({"kind": "bang-bang"}, (0.5,)),
    ({"kind": "trapezoidal", "ramp": 0.25}, (0.25, 0.75)),
    ({"kind": "double-s", "ramp": 0.3, "jerk_phase": 0.1}, (0.1, 0.2, 0.3, 0.7, 0.8, 0.9)),
    ({"kind": "harmonic"}, ()),
    ({"kind": "cycloidal"}, ()),
    ({"kind": "modified-sine"}, (0.125, 0.875)),
    ({"kind": "modified-trapezoid"}, (0.125, 0.375, 0.625, 0.875)),
    ({"kind": "polynomial", "coefficients": [0, 0, 6, -8, 3]}, ()),
])  # fmt: skip
def test_every_blend_and_profile(
    scene: Scene, blend: str, profile: dict[str, object], jumps: tuple[float, ...]
) -> None:
    """Each kind in the scene file becomes the motion that it names: its acceleration jumps show as breakpoints."""
    motion = plan(scene.replace({"trajectory.blend.kind": blend, "trajectory.profile": profile}))
    for jump in (0.0, *jumps, 1.0):
        assert min(abs(point - jump * motion.duration) for point in motion.joints.breakpoints) < 1e-12
    knots = 7 if blend == "clothoid" else 5
    assert len(motion.joints.breakpoints) >= knots - 1


def test_a_duration_changes_only_the_time(scene: Scene) -> None:
    """A plan that shares the checks of another duration has the bits of one that was made alone."""
    for kind in ("poly7", "bang-bang"):
        for duration in (0.43, 0.3512):
            changes = {"trajectory.profile": {"kind": kind}, "trajectory.duration": duration}
            shared = plan(scene.replace(changes))
            task = TaskTrajectory(shared.task.path, shared.task.profile, duration)
            alone = JointTrajectory(task, shared.kinematics)
            times = np.concatenate([np.linspace(-0.1, 0.6, 701), alone.breakpoints])
            assert shared.joints.breakpoints == alone.breakpoints
            for side in ("left", "right"):
                np.testing.assert_array_equal(shared.joints.evaluate(times, 6, side), alone.evaluate(times, 6, side))


def test_an_infeasible_motion_names_its_own_instant(scene: Scene) -> None:
    """The instant in the message is that of the motion: it grows with the duration."""
    fractions = []
    for duration in (0.43, 0.86):
        with pytest.raises(TrajectoryError) as raised:
            plan(scene.replace({"trajectory.height": 0.1, "trajectory.width": 1.4, "trajectory.duration": duration}))
        found = re.search(r"t = ([\d.]+) s", str(raised.value))
        assert found is not None
        fractions.append(float(found[1]) / duration)
    assert fractions[0] == pytest.approx(fractions[1], abs=1e-5)

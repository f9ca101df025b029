"""From the scene's keys to the planned motion."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The paper's scene with 6 kg."""
    return load_scene("barnard2012-6kg")


def test_the_papers_motion(scene: Scene) -> None:
    """The motion starts and ends where the paper's does, over a path of its Table 11's length, and lasts as long."""
    motion = plan(scene)
    ends = motion.task.evaluate([0.0, 0.43], order=0)[0]
    np.testing.assert_allclose(ends, [[-0.175, 0.320], [0.175, 0.320]], atol=1e-12)
    assert motion.along_path.path.length == pytest.approx(0.38431, abs=5e-6)
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
@pytest.mark.parametrize(
    ("profile", "jumps"),
    [({"kind": "poly7"}, ()), ({"kind": "bang-bang"}, (0.5,)), ({"kind": "trapezoidal", "ramp": 0.25}, (0.25, 0.75))],
)
def test_every_blend_and_profile(
    scene: Scene, blend: str, profile: dict[str, object], jumps: tuple[float, ...]
) -> None:
    """Each kind in the scene file becomes the motion that it names: its acceleration jumps show as breakpoints."""
    motion = plan(scene.replace({"trajectory.blend.kind": blend, "trajectory.profile": profile}))
    for jump in (0.0, *jumps, 1.0):
        assert min(abs(point - jump * motion.duration) for point in motion.joints.breakpoints) < 1e-12
    knots = 7 if blend == "clothoid" else 5
    assert len(motion.joints.breakpoints) >= knots - 1


def test_infeasible_motions_are_refused(scene: Scene) -> None:
    """A path out of the workspace is an error while planning, with point, time and margin."""
    with pytest.raises(TrajectoryError, match=r"reach of leg . .* t = .* s"):
        plan(scene.replace({"trajectory.height": 0.1, "trajectory.width": 1.4}))

"""From the scene's keys to the planned motion; and runs of own motions: the robot does what the class says, with the scene's shapers, cycles
and metrics."""

from __future__ import annotations

import re
from functools import cache
from math import pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import plan, plan_own, shape_joints, shape_path
from flexfmu.cosim.metrics.metrics import measure_run, metrics_of
from flexfmu.cosim.reports.modes_table import modes_along_path
from flexfmu.cosim.reports.report import report_page
from flexfmu.cosim.reports.summary import summarise
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.table import write_table
from flexfmu.trajectories.trajectory import TaskTrajectory


@cache
def robot() -> Scene:
    """The shipped scene, whose FMU most tests share, with steps so fine that runs with other communication points agree."""
    return load_scene("barnard2012-6kg").replace(
        {"trajectory.dwell": 0.05, "cosimulation.step": 1e-3, "cosimulation.tolerance": 1e-9}
    )


class Line:
    """20 cm to the right with the cycloidal profile."""

    duration = 0.4

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        u = 2.0 * pi * time / self.duration
        return -0.1 + 0.2 * (u - sin(u)) / (2.0 * pi), 0.33


class SamePath:
    """The positions of the scene's own path, without its derivatives."""

    def __init__(self, scene: Scene, coordinates: str) -> None:
        motion = plan(scene)
        self._motion = motion.joints if coordinates == "joints" else motion.task
        self.coordinates = coordinates
        self.duration = self._motion.duration
        self.breakpoints = self._motion.breakpoints

    def position(self, time: float) -> Any:
        """x and y [m], or the joint angles [rad]."""
        return self._motion.evaluate(time, 0)[0, 0]


@pytest.mark.parametrize("coordinates", ["end-effector", "joints"])
def test_positions_of_the_scenes_path_give_its_run(coordinates: str) -> None:
    """Polynomials through the positions of the path, or the joint angles, give the metrics that exact derivatives give."""
    own = flexfmu.run(robot(), trajectory=SamePath(robot(), coordinates))
    wanted = metrics_of(flexfmu.run(robot()))
    for name, value in metrics_of(own).items():
        assert value == pytest.approx(wanted[name], rel=1e-6, abs=1e-12), name


def test_summary_and_report_name_the_motion() -> None:
    """And not the path that the robot doesn't take."""
    run = flexfmu.run(robot(), trajectory=Line())
    assert run.completed
    summary = summarise(run, measure_run(run, 0))
    assert summary["motion"] == "own motion Line"
    keys = {"kind", "start", "duration", "dwell", "way_back", "cycles", "pause"}
    assert summary["scene"]["trajectory"].keys() == keys
    assert "Own motion Line in 0.4 s, then a dwell of 0.05 s" in report_page(summary, ()).html


def test_cycles_and_shapers_apply() -> None:
    """There and back, each motion shaped in the joints; a shaper along the path has no profile to act on."""
    scene = robot().replace({"trajectory.way_back": "same-path", "trajectory.cycles": 2, "trajectory.pause": 0.1})
    motion = flexfmu.reference_motion(scene, trajectory=Line())
    assert motion.duration == pytest.approx(4 * 0.4 + 3 * 0.1)
    np.testing.assert_allclose(motion.task.evaluate([0.4, 0.9], 0)[0], [[0.1, 0.33], [-0.1, 0.33]], atol=1e-12)
    own, sequence = plan_own(robot(), Line()), ImpulseSequence((0.0, 0.02), (0.5, 0.5))
    assert shape_joints(own, sequence).duration == pytest.approx(0.42)
    with pytest.raises(
        TrajectoryError, match="own motion Line has no profile along a path: shape the joint references"
    ):
        shape_path(own, sequence)


def test_modes_are_taken_along_the_motion() -> None:
    """Places at fractions of its length, in the middle of a straight line here."""
    poses = modes_along_path(plan_own(robot(), Line()), 3)
    np.testing.assert_allclose([pose.x for pose in poses], [-0.1, 0.0, 0.1], atol=1e-9)
    np.testing.assert_allclose([pose.y for pose in poses], 0.33, atol=1e-12)


def test_motions_that_the_robot_cannot_make_are_refused() -> None:
    """Out of reach, joint angles of another working mode, and an open choice of effects."""

    class Far(Line):
        def position(self, time: float) -> tuple[float, float]:
            x, y = super().position(time)
            return x, y + 3.0 * (x + 0.1)

    with pytest.raises(TrajectoryError, match="along the whole path"):
        flexfmu.reference_motion(robot(), trajectory=Far())

    class Turned(SamePath):
        def position(self, time: float) -> Any:
            return super().position(time) + 2.0 * pi

    with pytest.raises(TrajectoryError, match=r"starts at joint angles .* change `mechanism\.working_mode`"):
        flexfmu.reference_motion(robot(), trajectory=Turned(robot(), "joints"))
    odd = SamePath(robot(), "tool")
    with pytest.raises(
        TrajectoryError, match="`coordinates` of an own motion must be 'end-effector' or 'joints', got 'tool'"
    ):
        flexfmu.reference_motion(robot(), trajectory=odd)
    auto = {"select": "auto", "tolerance": 0.01, "of": ["peak_torque_1"]}
    choosing = robot().replace({"effects": robot().effects.model_dump(include={"gravity", "damping"}) | auto})
    with pytest.raises(InputError, match='has `select = "auto"`, which chooses the effects for the scene\'s own path'):
        flexfmu.run(choosing, trajectory=Line())


def test_the_pages_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """docs/motions.md can be copied."""
    page = (Path(__file__).parents[3] / "docs" / "motions.md").read_text(encoding="utf-8")
    (example,) = (block for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL) if "class " in block)
    exec(example, {"__name__": "example"})
    assert 10.0 < float(capsys.readouterr().out) < 60.0


def test_an_own_motion_takes_the_place_of_a_table_that_starts_there(tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    write_table(file, plan(robot()).task)
    tabulated = robot().replace({"trajectory": {"kind": "table", "file": str(file), "dwell": 0.05}})
    slower = plan(robot().replace({"trajectory.duration": 0.5}))
    run = flexfmu.run(tabulated, trajectory=slower.task)
    assert run.plan.duration == 0.5
    expected = flexfmu.run(slower.scene).metrics["peak_torque_1"]
    assert run.metrics["peak_torque_1"] == pytest.approx(float(expected), rel=1e-6)
    with pytest.raises(
        TrajectoryError, match=r"starts at \(-0.175, 0.32\) m, the own motion at \(-0.1, 0.33\) m: let it start"
    ):
        plan_own(tabulated, Line())


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

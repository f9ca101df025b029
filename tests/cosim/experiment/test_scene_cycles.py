"""Scenes with a way back, cycles and pauses, and a motion there and back: smooth where it should be, on both sides of every breakpoint."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import flexfmu
from flexfmu.cosim.control.shapers import Shaper
from flexfmu.cosim.experiment.cycles import ThereAndBack, repeated
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.many.variants import run_variants
from flexfmu.cosim.metrics.metrics import measure_run, measuring, metrics_of
from flexfmu.cosim.reports.report import report_page
from flexfmu.cosim.reports.summary import summarise
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.curves import Side
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.shapers.sequence import ImpulseSequence
from flexfmu.trajectories.trajectory import Trajectory

TWICE = {"trajectory.way_back": "same-path", "trajectory.cycles": 2, "trajectory.pause": 0.05}
LEARNING = {"kind": "learning", "gain": 1.0, "cycles": 3, "sample_time": 1e-3}
NAMES = ("peak_torque_1", "peak_torque_2", "peak_tip_deflection_1")


@cache
def robot(**changes: Any) -> Scene:
    """The shipped robot, whose FMU most tests share, a short motion, coarse steps."""
    return load_scene("barnard2012-6kg").replace(
        {"trajectory.duration": 0.3, "trajectory.dwell": 0.1, "cosimulation.step": 2e-3, **changes}
    )


@pytest.fixture(scope="module")
def cycles() -> flexfmu.Run:
    """A run of two cycles."""
    return flexfmu.run(robot().replace(TWICE))


def test_a_scene_of_cycles_is_the_repeated_motion() -> None:
    """Two cycles of 2 (0.3 + 0.05) s, without the last pause; the end effector comes back, and the middle is the place."""
    motion = flexfmu.reference_motion(robot().replace(TWICE))
    assert (motion.duration, motion.stop_time) == (pytest.approx(1.35), pytest.approx(1.45))
    assert motion.duration == pytest.approx(motion.scene.trajectory.moving_time, rel=1e-15)
    x = motion.task.evaluate([0.0, 0.325, 0.7, 1.025, 1.35], 1)
    np.testing.assert_allclose(x[0], np.array([[-0.175, 0.32], [0.175, 0.32]] * 2 + [[-0.175, 0.32]]), atol=1e-12)
    np.testing.assert_array_equal(x[1], 0.0)
    # the same as the repetition in Python
    again = repeated(plan(robot()), 2, dwell=0.05)
    time = np.linspace(0.0, 1.35, 200)
    np.testing.assert_array_equal(motion.joints.evaluate(time), again.joints.evaluate(time))


def test_metrics_are_those_of_the_whole_duty_cycle(cycles: flexfmu.Run) -> None:
    """Peaks are at least those of one motion, and the residual vibration is that about the pick position at the end."""
    once, whole = metrics_of(flexfmu.run(robot())), metrics_of(cycles)
    assert cycles.recording.time[-1] == pytest.approx(1.45)
    for name in NAMES:
        assert (whole[name] or 0.0) >= (once[name] or np.inf) * (1.0 - 1e-3)
    assert {name for name, value in once.items() if value is None} == {
        name for name, value in whole.items() if value is None
    }
    np.testing.assert_allclose(cycles.plan.end_pose[1], [-0.175, 0.32], atol=1e-12)


def test_shaped_motions_are_repeated_as_they_are() -> None:
    """Every motion of the cycles is longer by the shaper's duration, in scripts and in scenes."""
    sequence = ImpulseSequence((0.0, 0.02), (0.5, 0.5))
    run = flexfmu.run(robot().replace(TWICE), shapers=[Shaper(sequence)])
    assert run.plan.duration == pytest.approx(4 * 0.32 + 3 * 0.05)
    assert run.plan.once.duration == pytest.approx(0.32)


def test_summary_and_report_tell_of_the_cycles(cycles: flexfmu.Run) -> None:
    """flexfmu run writes number and period of the cycles."""
    summary = summarise(cycles, measure_run(cycles, 0))
    assert summary["cycles"] == {"number": 2, "period": pytest.approx(0.7), "motion": 0.3}
    assert "learning" not in summary
    assert "there and back 2 times with pauses of 0.05 s" in report_page(summary, ()).html


@pytest.mark.slow
def test_variants_of_parameters_run_side_by_side_over_all_cycles() -> None:
    """Payloads over two cycles in lockstep agree with runs of the FMU."""
    scene = robot().replace(TWICE)
    payloads = [{"payload.mass": 1.0 + 0.2 * k} for k in range(16)]
    found = run_variants(scene, payloads, measuring(["peak_torque_1"]))
    run = PreparedScene(scene).run({"payload.mass": 4.0})
    assert found[15].value == pytest.approx(metrics_of(run, ["peak_torque_1"]), rel=1e-4)


@pytest.mark.parametrize(("changes", "message"), [
    ({"trajectory.cycles": 3}, '`cycles` = 3 needs a way back: add `way_back = "same-path"`'),
    ({"trajectory.pause": 0.1}, '`pause` = 0.1 needs a way back: add `way_back = "same-path"`'),
    ({**TWICE, "trajectory.cycles": 0}, "`trajectory.cycles` must be at least 1"),
    ({**TWICE, "trajectory.pause": -0.1}, "`trajectory.pause` must be at least 0.0 s, got -0.1 s"),
    ({"trajectory.way_back": "other"}, "`trajectory.way_back`"),
    ({**TWICE, "controller": [LEARNING], "cosimulation.drive": "torque"},
     "controllers that learn repeat the motion there and back by their own `cycles`"),
])  # fmt: skip
def test_cycles_without_sense_are_refused(changes: dict[str, Any], message: str) -> None:
    """What is wrong and what would be right, on one line."""
    with pytest.raises(SceneError, match=message):
        robot().replace(changes)


def bang_bang(dwell: float) -> MotionPlan:
    """Three cycles of a motion whose acceleration jumps."""
    changes = {"trajectory.dwell": dwell, "trajectory.profile": {"kind": "bang-bang"}}
    return repeated(plan(load_scene("barnard2012-6kg").replace(changes)), 3)


@pytest.mark.parametrize("dwell", [0.0, 0.1])
def test_limits_are_those_of_the_neighbourhood(dwell: float) -> None:
    """Left and right limits at a breakpoint are what the motion comes to from either side, in every cycle."""
    motion = bang_bang(dwell).joints
    near = 1e-9
    points = np.array(motion.breakpoints)
    assert np.all(np.diff(points) > 0.0)
    np.testing.assert_allclose(motion.evaluate(points, 2, "left"), motion.evaluate(points - near, 2), atol=1e-5)
    np.testing.assert_allclose(motion.evaluate(points, 2, "right"), motion.evaluate(points + near, 2), atol=1e-5)


@pytest.mark.parametrize("dwell", [0.0, 0.1])
def test_it_comes_back(dwell: float) -> None:
    """After each cycle the joints are where they were; the way back is the way there, reversed in time."""
    motion = bang_bang(dwell).joints
    assert isinstance(motion, ThereAndBack)
    there = np.linspace(0.01, 0.42, 20)
    back = 2 * motion.motion.duration + motion.dwell - there
    forward, backward = motion.evaluate(there, 2), motion.evaluate(motion.period + back, 2)
    np.testing.assert_allclose(backward[::2], forward[::2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(backward[1], -forward[1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(motion.evaluate(motion.duration, 0), motion.evaluate(0.0, 0), atol=1e-12)


def test_late_cycles_have_the_limits_of_early_ones() -> None:
    """After hours, the rounding of the time is larger than what a motion takes for one instant: each side of a breakpoint must
    still be told from the other."""
    joints = plan(load_scene("barnard2012-6kg")).joints
    motion = ThereAndBack(joints, 0.02, 10_000)
    marks = len(joints.breakpoints) * 2
    points = np.array(motion.breakpoints)
    for side in ("left", "right"):
        second = motion.evaluate(points[marks : 2 * marks], 4, side)
        last = motion.evaluate(points[-marks:], 4, side)
        np.testing.assert_array_equal(last, second)


class Counting:
    """A trajectory that counts the evaluated instants."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory, self.count = trajectory, 0
        self.duration, self.breakpoints = trajectory.duration, trajectory.breakpoints

    def evaluate(self, time: ArrayLike, order: int = 2, side: Side = "right") -> RealArray:
        """As `Trajectory.evaluate`."""
        self.count += np.size(time)
        return self.trajectory.evaluate(time, order, side)


def test_equal_instants_of_all_cycles_are_evaluated_once() -> None:
    """The references of a hundred cycles cost those of one, have the same bits in all cycles, and in the first one those of the
    motion itself."""
    counting = Counting(plan(load_scene("barnard2012-6kg")).joints)
    motion = ThereAndBack(counting, 0.25, 100)
    cycle = round(motion.period / 1e-3)
    times = 1e-3 * np.arange(100 * cycle)
    found = motion.evaluate(times, 6).reshape(7, 100, cycle, 2)
    assert counting.count <= cycle
    np.testing.assert_array_equal(found, np.broadcast_to(found[:, :1], found.shape))
    np.testing.assert_array_equal(found[:, 0, :430], counting.trajectory.evaluate(times[:430], 6))

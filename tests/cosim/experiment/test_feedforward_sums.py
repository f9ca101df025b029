"""Several controllers that output the same feedforward: their sum, at the instants of the controller that takes it."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import WiringError
from flexfmu.cosim.experiment.scene_loop import counted_twice, loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.schema import Scene

PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
GRAVITY = {"kind": "gravity-feedforward", "sample_time": 2e-3}
FRICTION = {"kind": "friction-compensation", "viscous": 2.0, "sample_time": 5e-4, "offset": 1e-4}


def connections(run: Run) -> set[str]:
    """The connections of a run, as "output -> input"."""
    return {each.connection for each in run.delays}


def test_the_controller_adds_both(robot: Scene) -> None:
    """The torque of each sample is that of the PD and both feedforwards as they are at its instants, at their own rates."""
    run = run_scene(robot.replace({"controller": [PD, GRAVITY, FRICTION]}))
    assert run.completed, run.message
    assert connections(run) >= {
        "feedforward_sum.joint1.feedforward -> pd.joint1.feedforward",
        "gravity_feedforward.joint1.feedforward -> feedforward_sum.gravity_feedforward.joint1.feedforward",
    }
    recording = run.recording
    at = np.searchsorted(recording.time, 1e-3 * np.arange(400) + 1e-9) - 1
    for joint in ("joint1", "joint2"):
        signals = ("reference.position", "position", "reference.velocity", "velocity")
        q_r, q, v_r, v = (recording[f"{joint}.{each}"].values[at] for each in signals)
        terms = [
            recording[f"{name}.{joint}.feedforward"].values[at]
            for name in ("gravity_feedforward", "friction_compensation")
        ]
        expected = 1e4 * (q_r - q) + 100.0 * (v_r - v) + terms[0] + terms[1]
        assert min(abs(each).max() for each in terms) > 1.0
        np.testing.assert_allclose(
            recording[f"{joint}.torque"].values[at], expected, rtol=0.0, atol=1e-12 * abs(expected).max()
        )


def test_the_sum_has_the_clock_of_who_takes_it(robot: Scene) -> None:
    """One slave more, whose terms are named after their slaves; no slave more for one feedforward alone."""
    slow = {**PD, "sample_time": 3e-3, "offset": 1e-3}
    *_, total = loop_of(robot.replace({"controller": [GRAVITY, slow, FRICTION]})).controllers
    assert (total.name, total.sample_time, total.offset) == ("feedforward_sum", 3e-3, 1e-3)  # type: ignore[attr-defined]
    inputs = [each.name for each in total.variables if each.causality == "input"]
    assert inputs[:2] == ["gravity_feedforward.joint1.feedforward", "friction_compensation.joint1.feedforward"]
    assert len(loop_of(robot.replace({"controller": [GRAVITY, PD]})).controllers) == 2


def test_explicit_connections_come_first(robot: Scene) -> None:
    """Who names one of both gets that one."""
    chosen = {f"joint{i}.feedforward": f"gravity_feedforward.joint{i}.feedforward" for i in (1, 2)}
    scene = robot.replace({"controller": [GRAVITY, {**PD, "connect": chosen}, FRICTION], "trajectory.dwell": 0.0})
    assert "gravity_feedforward.joint1.feedforward -> pd.joint1.feedforward" in connections(run_scene(scene))
    assert len(loop_of(scene).controllers) == 3


def test_no_common_instants(robot: Scene) -> None:
    """Two controllers at different instants can't share a sum."""
    second = {**PD, "name": "second", "sample_time": 2e-3}
    with pytest.raises(
        WiringError,
        match=r"pd, second, which take the sum, aren't sampled at the same instants: give them one sample_time",
    ):
        loop_of(robot.replace({"controller": [GRAVITY, PD, FRICTION, second]}))


def test_what_counts_twice_is_told(robot: Scene) -> None:
    """The rigid torques have gravity and friction in them; without either in the scene nothing counts twice."""
    whole = {"kind": "feedforward", "sample_time": 1e-3}
    both = robot.replace({"controller": [PD, whole, GRAVITY, FRICTION], "effects.joint_friction.viscous": 1.0})
    gravity, friction = counted_twice(both)
    assert gravity.startswith("gravity counts twice: `feedforward` has it, and so does `gravity-feedforward`")
    assert friction.startswith("friction counts twice")
    assert counted_twice(both.replace({"effects.gravity": [0.0, 0.0], "effects.joint_friction.viscous": 0.0})) == []
    assert counted_twice(robot.replace({"controller": [PD, GRAVITY, FRICTION]})) == []

"""A scene through its FMU: what is recorded, what a change of parameters does, and how a failure ends."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The paper's scene with 6 kg and bang-bang profile, whose acceleration jumps, coarsely stepped."""
    scene = load_scene("barnard2012-6kg")
    return scene.replace({"trajectory.profile": {"kind": "bang-bang"}, "cosimulation.step": 1e-3})


@pytest.fixture(scope="module")
def run(scene: Scene) -> Run:
    """The scene's run."""
    return run_scene(scene)


def test_the_run_completes(run: Run) -> None:
    """Motion and dwell are simulated, with statistics, without complaints; exactly the breakpoints of the motion have a left and
    a right limit."""
    time = run.recording.time
    assert run.completed
    assert time[[0, -1]].tolist() == [0.0, run.plan.stop_time]
    np.testing.assert_array_equal(time[1:][np.diff(time) == 0.0], run.plan.joints.breakpoints)
    assert run.health.messages == ()
    assert run.health.statistics["steps"] > 100
    assert (run.communication_step, run.tolerance, run.input_order) == (1e-3, run.scene.cosimulation.tolerance, 9)


def test_elastic_accelerations_jump_with_the_reference(run: Run) -> None:
    """At the middle of a bang-bang motion the bending's acceleration jumps with that of the joint; position
    and velocity of the end effector don't jump."""
    left, right = np.flatnonzero(np.isclose(run.recording.time, 0.5 * run.plan.duration, rtol=0, atol=1e-12))

    def jump(name: str) -> float:
        values = run.recording[name].values
        return float(values[right] - values[left])

    assert abs(jump("joint1.reference.acceleration")) > 10.0
    assert abs(jump("der(link11.bending[1],2)")) > 1.0
    for name in ("position", "velocity"):
        assert abs(jump(f"end_effector.{name}.x")) < 1e-12


def test_references_are_the_plan(run: Run) -> None:
    """The references in the recording are the planned motion, one-sided at breakpoints."""
    time = run.recording.time
    right = np.append(np.diff(time) > 0.0, True)
    planned = run.plan.joints.evaluate(time[right], 2)
    for order, kind in enumerate(("position", "velocity", "acceleration")):
        for axis in range(2):
            values = run.recording[f"joint{axis + 1}.reference.{kind}"].values[right]
            np.testing.assert_allclose(values, planned[order, :, axis], rtol=1e-12, atol=1e-9)
    assert run.recording["joint1.reference.acceleration"].values[0] == 0.0
    np.testing.assert_allclose(
        run.recording["end_effector.reference.acceleration.x"].values[right],
        run.plan.task.evaluate(time[right], 2)[2, :, 0],
        rtol=1e-12,
        atol=1e-12,
    )


def test_derivatives_are_those_of_the_signals(run: Run) -> None:
    """The recorded derivatives of the position are the recorded velocity and acceleration."""
    for axis in "xy":
        position = run.recording[f"end_effector.position.{axis}"]
        velocity = run.recording[f"end_effector.velocity.{axis}"]
        acceleration = run.recording[f"end_effector.acceleration.{axis}"]
        assert position.first is not None
        assert position.second is not None
        assert velocity.first is not None
        np.testing.assert_allclose(position.first, velocity.values, atol=1e-9)
        np.testing.assert_allclose(position.second, acceleration.values, atol=1e-6)
        np.testing.assert_allclose(velocity.first, acceleration.values, atol=1e-6)


def test_every_signal_has_a_unit_and_derivatives(run: Run) -> None:
    """Metrics and plots find unit and derivatives of every signal; strains have no unit."""
    for name, column in run.recording.columns.items():
        assert column.unit or name.endswith("root_strain"), name
        assert column.first is not None, name
        assert column.second is not None, name


def test_parameters_need_no_new_fmu(scene: Scene, run: Run) -> None:
    """The 6 kg FMU with another payload, or run for another scene of the same effects, is the 0.1 kg robot."""
    light = scene.replace({"payload.mass": 0.1, "name": "light"})
    by_parameter = run_scene(scene, fmu_path=run.fmu_path, parameters={"payload.mass": 0.1})
    by_scene = run_scene(light, fmu_path=run.fmu_path)
    torque = by_parameter.recording["joint1.torque"].values
    np.testing.assert_array_equal(torque, by_scene.recording["joint1.torque"].values)
    assert abs(torque).max() < 0.7 * abs(run.recording["joint1.torque"].values).max()


def test_undeformed_start(scene: Scene, run: Run) -> None:
    """The start that the caller asks for overrules the scene's: the links begin straight, or bent by gravity."""
    undeformed = run_scene(scene, fmu_path=run.fmu_path, initial="undeformed")
    assert undeformed.recording["link11.bending[1]"].values[0] == 0.0
    assert run.recording["link11.bending[1]"].values[0] != 0.0


def test_lower_input_orders_cost_accuracy(scene: Scene) -> None:
    """The fewer input derivatives a tool can send, the further the end effector is off."""
    smooth = scene.replace({"trajectory.profile": {"kind": "poly7"}})
    exact = run_scene(smooth, tolerance=1e-10).recording["end_effector.position.x"].values
    errors = [
        abs(
            run_scene(smooth, tolerance=1e-10, input_order=order).recording["end_effector.position.x"].values - exact
        ).max()
        for order in (0, 1, 2, 4)
    ]
    assert all(fine < 0.2 * coarse for coarse, fine in pairwise(errors))


def test_a_failure_keeps_the_beginning(scene: Scene, run: Run) -> None:
    """Rods of rubber fold into the singularity on the way: the run says when and why, and what came before is kept."""
    rubber = run_scene(scene, parameters={"material.youngs_modulus": 1e7}, initial="undeformed")
    assert rubber.outcome is Outcome.STEP_FAILED
    assert rubber.message.startswith("plant failed")
    assert len(re.findall(r"\bat 0\.\d+ s\b", rubber.message)) == 1, rubber.message
    assert 0.0 < rubber.recording.time[-1] < run.plan.stop_time
    assert rubber.health.messages


def test_an_fmu_without_the_effect_is_refused(scene: Scene, run: Run) -> None:
    """An FMU made for modal damping can't show stiffness-proportional damping; ignoring it would be wrong in silence."""
    other = scene.replace({"effects.damping": {"kind": "stiffness", "time": 1e-4}})
    with pytest.raises(InputError, match=r"lacks damping\.time"):
        run_scene(other, fmu_path=run.fmu_path)

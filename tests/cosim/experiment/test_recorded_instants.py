"""Recording apart from communicating: fewer instants, instants between communication points, chosen steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.many.prepared_scene import PreparedScene, run_scene
from flexfmu.cosim.many.variants import run_variants
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

SMALL: dict[str, Any] = {"effects.proximal_bending": 1, "effects.distal_axial": 0, "trajectory.dwell": 0.05}
PD: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.01,
    "cosimulation.step": 5e-4,
    "controller": [{"kind": "pd", "proportional": 1e3, "derivative": 10.0, "sample_time": 1e-3}],
}
MODAL = "der("


@pytest.fixture(scope="module")
def robot() -> Scene:
    """Two elastic coordinates."""
    return load_scene("barnard2012-6kg").replace(SMALL)


def same(found: Recording, whole: Recording) -> bool:
    """Whether all instants found are in the other recording, with the same bits."""
    chosen = np.isin(whole.time, found.time)
    return np.array_equal(whole.time[chosen], found.time) and all(
        np.array_equal(whole[name].values[chosen], column.values) for name, column in found.columns.items()
    )


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, PD])
def test_every_nth_point(robot: Scene, changes: dict[str, Any]) -> None:
    """An interval of so many communication steps records the same bits at fewer instants: its multiples, jumps of the motion
    and the end; with controllers not each of their sample instants."""
    scene = robot.replace({"cosimulation.step": 5e-4} | changes)
    whole = run_scene(scene).recording
    some = run_scene(scene, record=Selection(None, 2, 2e-3))
    assert some.completed
    assert same(some.recording, whole)
    regular = np.round(some.recording.time / 2e-3) * 2e-3
    others = some.recording.time[abs(some.recording.time - regular) > 1e-9]
    assert {*others.tolist()} <= {*some.plan.joints.breakpoints, some.plan.stop_time}
    assert np.unique(some.recording.time).size < 0.3 * np.unique(whole.time).size


def test_instants_between_points(robot: Scene) -> None:
    """An interval below the step, or beside it, gives values between the points, to the tolerance."""
    scene = robot.replace({"cosimulation.step": 1.5e-3, "cosimulation.tolerance": 1e-8})
    fine = run_scene(scene, communication_step=5e-4, tolerance=1e-10).recording
    between = run_scene(scene, record=Selection(["joint1.torque", "end_effector.position.x"], 0, 5e-4)).recording
    assert np.array_equal(between.time, fine.time)
    for name, column in between.columns.items():
        expected = fine[name].values
        # right after a jump the step spans several periods of the fastest mode
        assert np.median(abs(column.values - expected)) < 1e-8 * abs(expected).max()
        assert column.first is None


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_chosen_steps_keep_the_tolerance(robot: Scene, tolerance: float) -> None:
    """At every recorded instant, of all signals but those of the modes' rates, for the scene's payload and another one."""
    scene = robot.replace({"cosimulation.step": "auto", "cosimulation.tolerance": tolerance})
    prepared = PreparedScene(scene)
    for parameters in ({}, {"payload.mass": 2.0}):
        found = prepared.run(parameters)
        exact = run_scene(scene, communication_step=1e-3, tolerance=1e-11, parameters=parameters).recording
        assert found.completed
        assert np.array_equal(found.recording.time, exact.time)
        for name, column in found.recording.columns.items():
            expected = exact[name].values
            if not name.startswith(MODAL):
                assert abs(column.values - expected).max() <= tolerance * abs(expected).max(), name


def test_chosen_steps_are_the_same_whatever_ran_before(robot: Scene) -> None:
    """The steps depend on scene and parameters, not on the runs before; neither on what the recording is for."""
    scene = robot.replace({"cosimulation.step": "auto"})
    prepared = PreparedScene(scene)
    first, changed, again = (prepared.run(each).recording for each in ({}, {"payload.mass": 0.1}, {}))
    assert same(first, again)
    assert same(PreparedScene(scene).run({"payload.mass": 0.1}).recording, changed)


def test_keys_of_the_scene(robot: Scene) -> None:
    """`record`, `record_step` and `record_order`, for runs and variants alike."""
    keys = {"record": ["joint1.torque"], "record_step": 1e-2, "record_order": 1, "step": 2e-3}
    scene = robot.replace({f"cosimulation.{key}": value for key, value in keys.items()})
    (variant,) = run_variants(scene, [{"payload.mass": 5.0}], lambda run: run.recording)
    assert variant.value is not None
    for recording in (run_scene(scene).recording, variant.value):
        assert [*recording.columns] == ["joint1.torque"]
        assert recording["joint1.torque"].first is not None
        assert recording["joint1.torque"].second is None
        assert recording.time.size < 70


def test_steps_are_chosen_only_for_a_motion(robot: Scene) -> None:
    """A torque-driven robot and one with controllers need a step; so does step control."""
    for changes in (
        PD | {"cosimulation.step": "auto"},
        {"cosimulation.step": None, "cosimulation.step_control": {"tolerance": 1e-3}},
    ):
        with pytest.raises(SceneError, match=r"`step` is missing: with .* it is needed, 1e-3 s for example"):
            robot.replace(changes)
    with pytest.raises(
        InputError, match="communication steps are chosen where the planned motion alone drives the robot"
    ):
        run_scene(robot.replace({"cosimulation.step": "auto"}), input_order=3)
    with pytest.raises(
        InputError, match=r"every whole number of communication steps of 0.0005 s, not every 0.0007 s; 0.0005 s"
    ):
        run_scene(robot.replace(PD), record=Selection(None, 2, 7e-4))

"""A prepared scene runs again and again, each time as a fresh one would, and rests where the equations do."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from weakref import ref

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run, rest_position
from flexfmu.cosim.many.prepared_scene import PreparedScene, run_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.statics import natural_frequencies, static_equilibrium
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.trajectory import limits

SCENE = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.2, "trajectory.dwell": 0.01})


def assert_same(first: Run, second: Run) -> None:
    """To the last bit, parameters included."""
    assert first.parameters == second.parameters
    assert first.recording.columns.keys() == second.recording.columns.keys()
    for name, column in first.recording.columns.items():
        assert np.array_equal(column.values, second.recording[name].values), name


def test_runs_are_those_of_fresh_scenes() -> None:
    """Nothing is left over from the run before: not its parameters, wrong ones neither, and not its state."""
    prepared = PreparedScene(SCENE, communication_step=1e-3)
    light = prepared.run({"payload.mass": 1.0})
    with pytest.raises(InputError, match=r"payload\.mass"):
        prepared.run({"payload.mass": -1.0})
    scenes_own = prepared.run()
    assert_same(light, run_scene(SCENE, communication_step=1e-3, parameters={"payload.mass": 1.0}))
    assert_same(scenes_own, run_scene(SCENE, communication_step=1e-3))
    assert light.recording["joint1.torque"].values[5] != scenes_own.recording["joint1.torque"].values[5]
    assert light.robot.payload.mass == 1.0


def test_another_motion_is_that_of_a_fresh_scene() -> None:
    """Duration, dwell, law and path may change; runs have the bits of a scene prepared alone, before and after a motion that
    can't be planned, and earlier runs keep their motion."""
    prepared = PreparedScene(SCENE, communication_step=1e-3)
    first, time = prepared.run(), prepared.run().recording.time.copy()
    for changes in (
        {"trajectory.duration": 0.25, "trajectory.dwell": 0.1},
        {"trajectory.profile": {"kind": "bang-bang"}},
        {"trajectory.height": 0.03},
        {},
    ):
        scene = SCENE.replace(changes)
        assert prepared.replan(scene)
        run, fresh = (
            prepared.run({"payload.mass": 2.0}),
            run_scene(scene, communication_step=1e-3, parameters={"payload.mass": 2.0}),
        )
        assert np.array_equal(run.recording.time, fresh.recording.time)
        assert_same(run, fresh)
        assert run.plan.scene == scene
        with pytest.raises(TrajectoryError):
            prepared.replan(SCENE.replace({"trajectory.height": 0.1, "trajectory.width": 1.4}))
        with pytest.raises(InputError, match="longer than the motion"):
            prepared.replan(SCENE.replace({"trajectory.duration": 5e-4}))
    assert np.array_equal(first.recording.time, time)
    assert first.plan.duration == 0.2


def test_what_depends_on_the_motion_is_not_used_again() -> None:
    """A start, which is a parameter of the FMU, other settings, a controller or a motion of the user's own need a new scene."""
    prepared = PreparedScene(SCENE, communication_step=1e-3)
    assert not prepared.replan(SCENE.replace({"trajectory.start": [-0.17, 0.32]}))
    assert not prepared.replan(SCENE.replace({"payload.mass": 1.0, "trajectory.duration": 0.3}))
    assert not PreparedScene(SCENE, motion=plan(SCENE)).replan(SCENE.replace({"trajectory.duration": 0.3}))
    driven = {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.01,
        "controller": [{"kind": "pd", "proportional": 1e3, "derivative": 10.0, "sample_time": 1e-3}],
    }
    scene = SCENE.replace(driven)
    assert not PreparedScene(scene).replan(scene.replace({"trajectory.duration": 0.3}))


def test_an_unknown_option_is_told_the_nearest() -> None:
    """Before anything is planned or built."""
    with pytest.raises(TypeError, match="run has no argument 'tolerence'; did you mean 'tolerance'"):
        flexfmu.run(SCENE, tolerence=1e-6)  # type: ignore[call-arg]


def test_the_memory_of_a_result_serves_the_next_run() -> None:
    """Where a result is dropped, nothing else holds its memory, from the first run on."""
    prepared = PreparedScene(SCENE, communication_step=1e-3)
    first = ref(prepared.run().recording.time.base)
    assert prepared.run().recording.time.base is first()


SHORT: dict[str, Any] = {"trajectory.duration": 0.2, "trajectory.dwell": 0.02, "cosimulation.step": 2e-3}
TORQUES: dict[str, Any] = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.05}


@pytest.mark.parametrize("changes", [{}, TORQUES], ids=["motion", "torques"])
@pytest.mark.parametrize("parameters", [{}, {"payload.mass": 2.0}, {"proximal.length": 0.241}], ids=str)
def test_the_fmu_rests_where_the_equations_do(changes: dict[str, Any], parameters: dict[str, float]) -> None:
    """Residual vibration is measured from there: tenths of micrometres in a sag of tens."""
    run = flexfmu.run(flexfmu.load_scene("barnard2012-6kg").replace(SHORT | changes), parameters=parameters)
    joints = run.plan.joints.evaluate(np.array([run.plan.duration]), 0, side="left")[0, 0]
    np.testing.assert_allclose(rest_position(run), static_equilibrium(run.robot, joints).position, rtol=0, atol=1e-15)


def test_the_fmu_vibrates_as_the_equations_do() -> None:
    """Its natural frequencies at rest are those of the mass and stiffness matrices, for each payload; a robot driven by torques
    has no locked motors, and one that deflects statically or not at all doesn't vibrate."""
    scene = flexfmu.load_scene("barnard2012-6kg").replace(SHORT)
    prepared = PreparedScene(scene)
    for mass in (6.0, 1.0):
        run = prepared.run({"payload.mass": mass})
        assert run.rests is not None
        found = run.rests.frequencies(run.parameters)
        np.testing.assert_allclose(found, natural_frequencies(run.robot, run.plan.end_pose[0]), rtol=1e-9)
        assert found.shape == (12,)
    none = [TORQUES, {"effects.proximal_bending": 0, "effects.distal_axial": 0}]
    for changes in none:
        run = flexfmu.run(scene.replace(changes))
        assert run.rests is not None
        assert run.rests.frequencies({}).size == 0


@pytest.mark.parametrize("changes", [{}, TORQUES], ids=["motion", "torques"])
def test_runs_of_one_motion_share_the_fmu_that_rests(changes: dict[str, Any]) -> None:
    """Each robot has its own equilibrium, in any order, to the last bit that of a run by itself."""
    scene = flexfmu.load_scene("barnard2012-6kg").replace(SHORT | changes)
    prepared = PreparedScene(scene)
    runs = [prepared.run({"payload.mass": mass}) for mass in (1.0, 3.0, 1.0)]
    found = [rest_position(run) for run in runs]
    alone = [rest_position(replace(run, rests=None)) for run in runs]
    np.testing.assert_array_equal(found, alone)
    np.testing.assert_array_equal(found[0], found[2])
    assert np.abs(found[0] - found[1]).max() > 1e-7


def test_each_motion_has_its_own_rest() -> None:
    """A prepared scene that follows another motion rests at that one's end; earlier runs keep theirs."""
    scene = flexfmu.load_scene("barnard2012-6kg").replace(SHORT)
    prepared = PreparedScene(scene)
    first = prepared.run({"payload.mass": 3.0})
    before = rest_position(first)
    assert prepared.replan(scene.replace({"trajectory.width": 0.3}))
    second = prepared.run({"payload.mass": 3.0})
    for run in (first, second):
        np.testing.assert_array_equal(rest_position(run), rest_position(replace(run, rests=None)))
    np.testing.assert_array_equal(rest_position(first), before)
    assert before[0] - rest_position(second)[0] == pytest.approx(0.05, abs=1e-4)


def test_a_tabulated_motion_is_the_motion() -> None:
    """Its limits are kept for the same instants, sides and order, and for no others."""
    motion = plan(flexfmu.load_scene("barnard2012-6kg").replace(SHORT))
    task, _ = motion.tabulated
    time = np.linspace(-0.01, 0.21, 23)
    first = task.limits(time, time < 0.1, 4)
    assert task.limits(time.copy(), time < 0.1, 4) is first
    for instants, left, order in ((time, time < 0.05, 4), (time + 1e-3, time < 0.1, 4), (time, time < 0.1, 3)):
        np.testing.assert_array_equal(task.limits(instants, left, order), limits(motion.task, instants, left, order))
    np.testing.assert_array_equal(task.limits(time, time < 0.1, 4), first)

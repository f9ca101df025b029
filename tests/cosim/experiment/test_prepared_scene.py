"""A prepared scene runs again and again, each time as a fresh one would."""

from __future__ import annotations

from weakref import ref

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.prepared_scene import PreparedScene, Run, run_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.errors import TrajectoryError

SCENE = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.2, "trajectory.dwell": 0.01})


def assert_same(first: Run, second: Run) -> None:
    """To the last bit, parameters included."""
    assert first.parameters == second.parameters
    assert first.recording.columns.keys() == second.recording.columns.keys()
    for name, column in first.recording.columns.items():
        assert np.array_equal(column.values, second.recording[name].values), name


@pytest.mark.slow
def test_runs_are_those_of_fresh_scenes() -> None:
    """Nothing is left over from the run before: not its parameters, and not its state."""
    prepared = PreparedScene(SCENE, communication_step=1e-3)
    light, scenes_own = prepared.run({"payload.mass": 1.0}), prepared.run()
    assert_same(light, run_scene(SCENE, communication_step=1e-3, parameters={"payload.mass": 1.0}))
    assert_same(scenes_own, run_scene(SCENE, communication_step=1e-3))
    assert light.recording["joint1.torque"].values[5] != scenes_own.recording["joint1.torque"].values[5]
    assert light.robot.payload.mass == 1.0


@pytest.mark.slow
def test_a_wrong_parameter_leaves_the_scene_usable() -> None:
    """The error names the parameter; the next run is as if nothing had been asked."""
    prepared = PreparedScene(SCENE, communication_step=1e-3)
    with pytest.raises(InputError, match=r"payload\.mass"):
        prepared.run({"payload.mass": -1.0})
    assert_same(prepared.run(), run_scene(SCENE, communication_step=1e-3))


@pytest.mark.slow
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


@pytest.mark.slow
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


def test_the_memory_of_a_result_serves_the_next_run() -> None:
    """Where a result is dropped, nothing else holds its memory, from the first run on."""
    prepared = PreparedScene(SCENE, communication_step=1e-3)
    first = ref(prepared.run().recording.time.base)
    assert prepared.run().recording.time.base is first()

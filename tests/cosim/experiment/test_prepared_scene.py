"""A prepared scene runs again and again, each time as a fresh one would."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.prepared_scene import PreparedScene, Run, run_scene
from flexfmu.model.scene.file import load_scene

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

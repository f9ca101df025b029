"""Where the end effector rests after a run, by the FMU's own statics against the equations in CasADi."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.prepared_scene import PreparedScene
from flexfmu.cosim.experiment.scene_run import rest_position
from flexfmu.model.modes import natural_frequencies
from flexfmu.model.statics import static_equilibrium
from flexfmu.trajectories.trajectory import limits

SHORT: dict[str, Any] = {"trajectory.duration": 0.2, "trajectory.dwell": 0.02, "cosimulation.step": 2e-3}
TORQUES: dict[str, Any] = {"cosimulation.drive": "torque", "effects.motor_inertia": 0.05}


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, TORQUES], ids=["motion", "torques"])
@pytest.mark.parametrize("parameters", [{}, {"payload.mass": 2.0}, {"proximal.length": 0.241}], ids=str)
def test_the_fmu_rests_where_the_equations_do(changes: dict[str, Any], parameters: dict[str, float]) -> None:
    """Residual vibration is measured from there: tenths of micrometres in a sag of tens."""
    run = flexfmu.run(flexfmu.load_scene("barnard2012-6kg").replace(SHORT | changes), parameters=parameters)
    joints = run.plan.joints.evaluate(np.array([run.plan.duration]), 0, side="left")[0, 0]
    np.testing.assert_allclose(rest_position(run), static_equilibrium(run.robot, joints).position, rtol=0, atol=1e-15)


@pytest.mark.slow
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


def test_metrics_of_a_run_load_no_casadi(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model in CasADi takes forty times as long as the run."""
    run = flexfmu.run(flexfmu.load_scene("barnard2012-6kg").replace(SHORT))
    monkeypatch.setitem(sys.modules, "flexfmu.model.statics", None)
    assert flexfmu.measure_run(run)["residual_vibration_amplitude"].value is not None


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

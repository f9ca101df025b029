"""Runs that fail: what is blamed is at fault, and the remedy is one of the scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.control.controllers.own_function import controller
from flexfmu.cosim.engine.errors import LoopWarning
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.many.prepared_scene import PreparedScene, run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

EXAMPLE = Path(__file__).parents[3] / "examples" / "controller_scene.toml"
IMAGINARY_AXIS = {"rk4": 2.8284, "dopri5": 1.0}
"""Method → end of its stability interval on the imaginary axis, where undamped modes are."""

PD: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}],
}
"""A stable loop."""


@pytest.fixture(scope="module")
def undamped() -> Scene:
    """The paper's robot with one bending mode, without damping, coarsely stepped."""
    changes: dict[str, Any] = {"effects.damping": {"kind": "none"}, "effects.proximal_bending": 1}
    return load_scene("barnard2012-6kg").replace(
        {**changes, "effects.distal_axial": 0, "trajectory.dwell": 0.0, "cosimulation.step": 1e-2}
    )


def pushed(scene: Scene, torques: tuple[float, float]) -> flexfmu.Run:
    """A run with constant torques."""

    @controller(sample_time=1e-3, outputs=["joint1.torque", "joint2.torque"])
    def push(reference, measurement):  # type: ignore[no-untyped-def]
        return list(torques)

    driven = scene.replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
    return flexfmu.run(driven, controllers=[push])


@pytest.mark.parametrize("method", IMAGINARY_AXIS)
def test_an_unstable_explicit_step_is_blamed_for_what_it_blows_up(undamped: Scene, method: str) -> None:
    """Explicit methods are unstable from a known product of step and largest frequency: there the step is too large, not a
    singularity near, though the motion that grows may pass one; with smaller ones the run completes."""
    fastest = 2.0 * np.pi * max(max(pose.frequencies) for pose in flexfmu.modes(undamped, 3))
    # far beyond the end of the interval both methods blow up within a few steps
    for step, is_stable in ((0.9 * IMAGINARY_AXIS[method], True), (4.0, False), (6.0, False), (15.0, False)):
        settings = {"cosimulation.integrator": method, "cosimulation.integrator_step": float(step / fastest)}
        run = run_scene(undamped.replace({**settings, "cosimulation.step": 0.1}))
        assert run.completed is is_stable, (step, run.message)
        if not is_stable:
            assert "singularity" not in run.message
            assert "make `cosimulation.integrator_step` smaller" in run.message


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize("torques", [(60.0, 60.0), (-100.0, 100.0), (60.0, 0.0)])
def test_a_singularity_is_still_one(undamped: Scene, torques: tuple[float, float]) -> None:
    """Torques push the robot into it: a stable explicit step says so, as error control does."""

    for settings in ({}, {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": 5e-5}):
        run = pushed(undamped.replace(settings), torques)
        assert not run.completed
        assert "(type-2 singularity) is 0.0" in run.message


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.RunWarning")
@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize("torque", [1e10, 1e30, 1e300])
def test_an_absurd_input_is_named(undamped: Scene, torque: float) -> None:
    """Numbers that overflow come from it, not from a mechanism that can't be assembled."""

    run = pushed(undamped, (0.0, torque))
    assert f"check the inputs, of which joint2.torque = {torque:.6g} N.m is the largest" in run.message
    assert "assembled" not in run.message


def test_an_absurd_blend_is_named(undamped: Scene) -> None:
    """So is the acceleration of a path that turns within a nanometre."""
    run = run_scene(undamped.replace({"trajectory.blend.width": 1e-9, "cosimulation.step": 2e-4}))
    assert ".reference.acceleration = " in run.message
    assert "assembled" not in run.message


def test_a_static_start_that_fails_names_the_key() -> None:
    """The scene says "undeformed", not 2."""
    run = run_scene(load_scene("barnard2012-6kg").replace({"payload.mass": 1e6}))
    assert run.outcome is Outcome.INITIALISATION_FAILED
    assert 'start undeformed (`cosimulation.initial` = "undeformed")' in run.message
    assert "initial = 2" not in run.message


@pytest.mark.slow
def test_stiction_at_the_tightest_tolerance() -> None:
    """A slow motion far from the origin changes less in a step than its angles' last digits: that is no error, whatever the method."""
    scene = load_scene(EXAMPLE).replace({"shaper": [], "imperfection": [], "trajectory.duration": 3.0})
    friction = {"kind": "stiction", "coulomb": 1.0}
    scene = scene.replace(
        {"effects.joint_friction": friction, "cosimulation.step": 1e-3, "cosimulation.tolerance": 1e-12}
    )
    found = []
    for method in ("automatic", "dopri5"):
        prepared = PreparedScene(scene.replace({"cosimulation.integrator": method}))
        prepared.stop_time = 0.3
        run = prepared.run()
        assert run.completed, run.message
        found.append(np.array([run.recording[f"joint{j}.position"].values for j in (1, 2)]))
    assert abs(found[0] - found[1]).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize(("integrator", "step"), [("rk4", 5e-5), ("rk4", 7e-5), ("dopri5", 5e-5), ("dopri5", 3e-4)])
def test_a_long_fixed_step_is_not_the_loops_fault(integrator: str, step: float) -> None:
    """A stable loop whose explicit integrator diverges: the step is the cause, the loop is named in the second place."""
    changes = {"cosimulation.integrator": integrator, "cosimulation.integrator_step": step}
    run = run_scene(load_scene("starter").replace(PD | changes))
    assert run.outcome is Outcome.STEP_FAILED
    remedy, found, _ = run.message.partition("make `cosimulation.integrator_step` smaller")
    assert "unstable" not in remedy
    assert found


def test_python_is_told_of_a_loop_that_margins_call_unstable() -> None:
    """A robot that its controller lets go falls slowly: `flexfmu.run` says what `flexfmu run` does."""
    gone = PD | {"controller.pd.proportional": 0.0, "controller.pd.derivative": 0.0, "trajectory.dwell": 0.0}
    with pytest.warns(LoopWarning, match="the loop is unstable about"):
        run = flexfmu.run(load_scene("barnard2012-6kg").replace(gone))
    assert run.completed
    assert "the loop is unstable about" in run.health.messages[-1]


@pytest.mark.parametrize(("dwell", "step"), [(1e-12, 1e-3), (1e-10, 2e-4), (1e-9, 2e-4), (1e-8, 2e-2)])
def test_a_dwell_without_an_instant_is_none(dwell: float, step: float) -> None:
    """Acceleration errors are those before the last jump, however short the dwell after it is."""
    scene = load_scene("barnard2012-0.1kg").replace(
        {"trajectory.profile": {"kind": "bang-bang"}, "cosimulation.step": step}
    )
    found, expected = (
        measure_run(run_scene(scene.replace({"trajectory.dwell": each})), companions=0)["end_acceleration_error"]
        for each in (dwell, 0.0)
    )
    assert found.value == pytest.approx(expected.value, rel=1e-4)

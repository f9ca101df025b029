"""Scenes without elastic states, from rigid links to links that deflect statically, as FMUs."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.many.prepared_scene import PreparedScene, run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

RIGID = {"effects.proximal_bending": 0, "effects.distal_axial": 0}


def scene(changes: dict[str, object]) -> Scene:
    return load_scene("barnard2012-6kg").replace({"cosimulation.step": 1e-3} | changes)


def columns(recording: Recording, *names: str) -> np.ndarray:
    return np.stack([recording[name].values for name in names])


def test_a_rigid_robot_needs_the_torques_of_inverse_dynamics() -> None:
    """Without any state the FMU is a formula, and the end effector is where the rigid robot has it."""
    recording = run_scene(scene(RIGID)).recording
    kinds = ("position", "velocity", "acceleration")
    motion = [columns(recording, *(f"joint{i}.reference.{kind}" for i in (1, 2))) for kind in kinds]
    expected = inverse_dynamics(scene(RIGID)).map(len(recording.time))(*motion).full()
    torque = columns(recording, "joint1.torque", "joint2.torque")
    np.testing.assert_allclose(torque, expected, atol=1e-9 * np.abs(expected).max())
    position = [
        columns(recording, *(f"end_effector.{kind}.{axis}" for axis in "xy"))
        for kind in ("position", "reference.position")
    ]
    np.testing.assert_allclose(*position, atol=1e-12)


def test_a_rigid_robot_stays_where_its_torques_hold_it() -> None:
    """Torque-driven, the motors' angles are the only unknowns, and the holding torques balance gravity."""
    recording = run_scene(scene(RIGID | {"cosimulation.drive": "torque", "trajectory.dwell": 0.0})).recording
    joints = columns(recording, "joint1.position", "joint2.position")
    assert np.abs(joints - joints[:, :1]).max() < 1e-8


@pytest.mark.parametrize("family", ["distal_bending", "proximal_axial"])
def test_one_family_alone_runs(family: str) -> None:
    """Pinned links that bend move neither elbows nor end effector: their motion is resolved all the same, by what bends."""
    one = scene(RIGID | {f"effects.{family}": 1, "effects.basis": "craig-bampton"})
    name = "link12.bending[1]" if family == "distal_bending" else "link11.axial[1]"
    loose, tight = (PreparedScene(one, tolerance=tolerance).run() for tolerance in (1e-6, 1e-10))
    assert loose.completed, loose.message
    found, exact = (run.recording[name].values for run in (loose, tight))
    assert np.abs(found - exact).max() < 1e-5 * np.abs(exact).max()


def test_a_slow_motion_bends_the_links_statically() -> None:
    """Far below the first frequency, links without states err by what the vibration adds, which falls with the duration."""
    full = {"effects.basis": "craig-bampton", "effects.proximal_bending": 1, "effects.distal_axial": 1}
    errors = []
    for duration in (0.6, 1.2):
        vibrating = scene(full | {"trajectory.duration": duration})
        static = vibrating.replace({"effects.quasi_static": ["proximal_bending", "distal_axial"]})
        peak, found = (
            measure_run(run_scene(each), companions=0)["peak_position_error"].value for each in (vibrating, static)
        )
        assert peak is not None
        assert found is not None
        errors.append(abs(found / peak - 1.0))
    assert errors[1] < 0.02
    assert errors[1] < 0.4 * errors[0]

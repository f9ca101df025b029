"""Elastic families that deflect statically: no states, no dynamics of their own, the right deflection under the loads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import root

from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies

POSE = (-0.1, 0.3)
FAMILIES = ("distal_axial", "proximal_axial", "proximal_bending")
VARIANTS = {
    "the paper's": {"effects.proximal_axial": 2},
    "static shapes": {"effects.basis": "craig-bampton", "effects.proximal_axial": 1},
    "thick": {"effects.beam": "timoshenko", "effects.proximal_axial": 1},
}


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS.keys())
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene("barnard2012-6kg").replace(request.param)


def without(scene: Scene, family: str) -> Scene:
    return scene.replace({f"effects.{family}": 0})


def statically(scene: Scene, *families: str) -> Scene:
    return scene.replace({"effects.quasi_static": list(families)})


@pytest.mark.parametrize(("variant", "family"), list(zip(VARIANTS, FAMILIES, strict=True)))
def test_the_dynamics_are_those_without_the_family(variant: str, family: str) -> None:
    """No state and not one operation more in the equations of motion, whichever the family and its shapes."""
    scene = load_scene("barnard2012-6kg").replace(VARIANTS[variant])
    left_out, static = build_model(without(scene, family)), build_model(statically(scene, family))
    assert static.unknowns == left_out.unknowns
    for function in ("residual", "mass_matrix"):
        assert static.functions[function].n_instructions() == left_out.functions[function].n_instructions()
    joints = motor_angles(scene.mechanism, POSE)
    np.testing.assert_allclose(
        natural_frequencies(statically(scene, family), joints),
        natural_frequencies(without(scene, family), joints),
        rtol=1e-12,
    )


def test_under_the_loads_of_a_motion_the_robot_deflects_as_its_springs_do(scene: Scene) -> None:
    """Without any state the end effector is where the full model's springs balance inertia, to second order."""
    joints = np.array(motor_angles(scene.mechanism, POSE))
    u = np.concatenate([joints, [2.0, -3.0], [150.0, -80.0]])
    full, static = numeric_model(scene), numeric_model(statically(scene, *FAMILIES))
    zeros = np.zeros(full.n)
    balance = root(lambda q: full.elastic_forces(q, zeros, zeros, u).full().ravel(), zeros, tol=1e-14).x
    expected = full.motion(balance, zeros, zeros, u)[0].full().ravel()
    rigid = full.motion(zeros, zeros, zeros, u)[0].full().ravel()
    assert static.n == 0
    found = static.motion([], [], [], u)[0].full().ravel()
    assert np.hypot(*(found - expected)) < 5e-3 * np.hypot(*(expected - rigid))


def test_forces_at_the_end_effector_deflect_it_too(scene: Scene) -> None:
    """The torque-driven plant yields to a pull by the compliance of its static families, J K^-1 J'."""
    scene = scene.replace({"effects.gravity": [0.0, 0.0], "effects.proximal_bending": 0, "effects.proximal_axial": 0})
    plant = build_model(statically(scene.replace({"cosimulation.drive": "torque"}), "distal_axial"))
    names = [variable.name for variable in plant.outputs]
    derived = plant.functions["derive"]([variable.start or 0.0 for variable in plant.parameters])
    joints, rest = np.array(motor_angles(scene.mechanism, POSE)), np.zeros(2)

    def position(force: float) -> np.ndarray:
        values = plant.functions["outputs"](joints, rest, rest, [0.0, 0.0, 0.0, force], derived).full().ravel()
        return np.array([values[names.index(f"end_effector.position.{axis}")] for axis in "xy"])

    model, u = numeric_model(scene), standstill(joints)
    zeros, step = np.zeros(model.n), 1e-5
    tips = [[model.motion(sign * step * e, zeros, zeros, u)[0].full() for sign in (1, -1)] for e in np.eye(model.n)]
    by_q = np.hstack([(ahead - behind) / (2 * step) for ahead, behind in tips])
    expected = by_q @ np.linalg.solve(model.static_stiffness(zeros, u).full(), by_q[1])
    np.testing.assert_allclose((position(1e3) - position(-1e3)) / 2e3, expected, rtol=1e-6)

"""Rigid kinematics: working modes, jets and the margins that planning relies on."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.assembly import WORKING_MODES, assembly_side, elbows, motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.jets import Jet


def kinematics(working_mode: str = "elbows-out") -> RigidKinematics:
    mechanism = load_scene("barnard2012-6kg").mechanism.model_copy(update={"working_mode": working_mode})
    side = "left" if assembly_side(*elbows(mechanism, (0.03, 0.3)), (0.03, 0.3)) > 0 else "right"
    return RigidKinematics(mechanism.model_copy(update={"assembly_mode": side}))


@pytest.mark.parametrize("working_mode", WORKING_MODES)
def test_inverse_kinematics_closes_both_legs(working_mode: str) -> None:
    """In every working mode the elbows are at the proximal length from the bases and at the distal length from the tip."""
    robot, position = kinematics(working_mode), np.array([0.03, 0.3])
    a = robot.mechanism.base_half_distance
    for base, elbow, angle in zip(
        [(-a, 0), (a, 0)], elbows(robot.mechanism, (0.03, 0.3)), motor_angles(robot.mechanism, (0.03, 0.3)), strict=True
    ):
        np.testing.assert_allclose(
            np.subtract(elbow, base), 0.24 * np.array([np.cos(angle), np.sin(angle)]), atol=1e-15
        )
        assert np.hypot(*(position - elbow)) == pytest.approx(0.38079, rel=1e-14)


@pytest.mark.parametrize("working_mode", WORKING_MODES)
def test_joint_jets_are_the_derivatives_of_the_inverse(working_mode: str) -> None:
    """Jets to order 4 along a curve agree with a Taylor expansion of the inverse itself."""
    robot = kinematics(working_mode)
    x = Jet.from_derivatives(np.array([0.03, 1.2, -3.0, 8.0, 20.0]))
    y = Jet.from_derivatives(np.array([0.30, -0.4, 5.0, -9.0, 10.0]))
    q11, q21 = robot.joints(x, y)
    t = 1e-3
    powers = t ** np.arange(5)
    exact = motor_angles(robot.mechanism, (float(x.coefficients @ powers), float(y.coefficients @ powers)))
    np.testing.assert_allclose([q11.coefficients @ powers, q21.coefficients @ powers], exact, atol=1e-11)


def test_margins_fall_to_zero_where_the_leg_is_stretched_and_the_elbows_meet() -> None:
    """Reach margins are distances to the two circles; the sine is undefined out of reach."""
    robot = kinematics()
    stretched = -0.1 + 0.24 + 0.38079 - 0.01
    reach1, reach2, sine = robot.margins(np.array([[stretched, 0.0], [0.03, 0.3], [0.0, 2.0]]))
    assert reach1.values[0] == pytest.approx(0.01, rel=1e-9)
    assert np.all(np.array([reach1.values[1], reach2.values[1], sine.values[1]]) > 0.05)
    assert reach1.values[2] < 0.0
    assert np.isnan(sine.values[2])

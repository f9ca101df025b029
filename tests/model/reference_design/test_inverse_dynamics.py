"""References with which the flexible end effector follows a motion, judged by integrating the equations of motion."""

from __future__ import annotations

from math import comb, factorial

import numpy as np
import pytest

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.reference_design.elastic_response import ElasticResponse
from flexfmu.model.reference_design.inverse_dynamics import LEAD, FlexibleReferences, flexible_references
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.piecewise import PiecewisePolynomial

DURATION = 0.16


@pytest.fixture(scope="module")
def motion() -> PiecewisePolynomial:
    """A straight line with a polynomial of degree 13 in time: six derivatives are zero at both ends."""
    n, way = 6, np.array([0.2, 0.02])
    rise = np.zeros(2 * n + 2)
    for k in range(n + 1):
        rise[n + 1 + k] = (-1) ** k * comb(n, k) * factorial(2 * n + 1) / (factorial(n) ** 2 * (n + 1 + k))
    coefficients = (rise / DURATION ** np.arange(2 * n + 2))[:, np.newaxis, np.newaxis] * way
    coefficients[0] += np.array([-0.1, 0.32])
    return PiecewisePolynomial(np.array([0.0, DURATION]), coefficients)


def designed(robot: Scene, motion: PiecewisePolynomial, knot_spacing: float) -> FlexibleReferences:
    """References for a motion."""
    return flexible_references(robot, motion, JointTrajectory(motion, RigidKinematics(robot.mechanism)), knot_spacing)


def followed(robot: Scene, motion: PiecewisePolynomial, design: FlexibleReferences) -> tuple[float, RealArray, float]:
    """Largest distance of the flexible end effector from where it should be [m], its end state, largest error of the torque [N m]."""
    joints = design.motors
    response = ElasticResponse(robot, [{}], joints.coefficients[0], 4 * joints.intervals)
    found = response.of_spline(joints, derivatives=False)
    time = response.fractions * joints.duration
    error = np.hypot(*(found.position[0] - motion.evaluate(time - LEAD, 0)[0]).T)
    torque = np.abs(found.torque[0] - design.torque(time))
    return float(error.max()), found.end[0], float(torque.max())


def test_the_flexible_end_effector_follows_the_motion(robot: Scene, motion: PiecewisePolynomial) -> None:
    """Rigid references leave hundreds of micrometres; with these the error falls with the fourth power of the knots' distance."""
    errors = [followed(robot, motion, designed(robot, motion, spacing))[0] for spacing in (0.004, 0.002)]
    assert errors[1] < 1e-9
    assert 3.5 < np.log2(errors[0] / errors[1]) < 5.0


def test_the_robot_is_at_rest_after_the_motion(robot: Scene, motion: PiecewisePolynomial) -> None:
    """What is left of the vibration is what the splines miss of the motion."""
    design = designed(robot, motion, 0.002)
    model, end = design.model, followed(robot, motion, design)[1]
    rest = model.rest(design.motors.coefficients[-1])
    np.testing.assert_allclose(rest.position[0], motion.rest[1], rtol=0, atol=1e-12)
    assert np.abs(end[0] - rest.elastic[0]).max() < 1e-7
    assert np.abs(end[1]).max() < 1e-4


def test_the_torque_is_that_of_the_flexible_robot(robot: Scene, motion: PiecewisePolynomial) -> None:
    """It serves as feedforward: tens of newton metres, met to a millinewton metre."""
    design = designed(robot, motion, 0.002)
    assert followed(robot, motion, design)[2] < 1e-3
    at_rest = design.model.rest(design.motors.coefficients[0]).torque[0]
    np.testing.assert_allclose(design.torque(np.array([-1.0, 0.0])), [at_rest, at_rest], rtol=0, atol=1e-9)


def test_a_rigid_robot_gets_the_rigid_references(robot: Scene, motion: PiecewisePolynomial) -> None:
    """Without elastic coordinates what remains is inverse kinematics, at the knots to rounding."""
    stiff = robot.replace({"effects.proximal_bending": 0})
    design = designed(stiff, motion, 0.002)
    intervals = design.motors.intervals
    knots = np.arange(2, intervals - 1) / intervals
    rigid = JointTrajectory(motion, RigidKinematics(robot.mechanism))
    expected = rigid.evaluate(knots * design.motors.duration - LEAD, 0)[0]
    np.testing.assert_allclose(design.motors.evaluate(knots, 0)[0], expected, rtol=0, atol=1e-11)


def test_the_sag_is_taken_back(robot: Scene, motion: PiecewisePolynomial) -> None:
    """Before it moves, the flexible end effector is at the start, with motor angles beside the rigid ones."""
    design = designed(robot, motion, 0.004)
    angles = design.motors.coefficients[0]
    rigid = JointTrajectory(motion, RigidKinematics(robot.mechanism)).evaluate(0.0, 0)[0, 0]
    np.testing.assert_allclose(design.model.rest(angles).position[0], motion.rest[0], rtol=0, atol=1e-12)
    assert 2e-5 < np.abs(angles - rigid).max() < 1e-3


def test_knots_that_are_too_few(robot: Scene, motion: PiecewisePolynomial) -> None:
    """The error names the key and a value that would do."""
    with pytest.raises(TrajectoryError, match=r"`knot_spacing` to 0\.016 s"):
        designed(robot, motion, 0.05)

"""References with which the flexible end effector follows a motion, judged by integrating the equations of motion."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.reference_design.elastic_response import ElasticResponse, RobotVariant
from flexfmu.model.reference_design.inverse_dynamics import KNOT_SPACING, LEAD, FlexibleReferences, flexible_references
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.piecewise import PiecewisePolynomial


@pytest.fixture(scope="module")
def robot() -> Scene:
    """One bending mode for each proximal link; little damping, so that nothing is forgiven."""
    few = {"effects.proximal_bending": 1, "effects.distal_axial": 0, "effects.damping.ratio": 0.01}
    return load_scene("barnard2012-6kg").replace(few)


def line(n: int, duration: float) -> PiecewisePolynomial:
    """A straight line whose first n derivatives are zero at both ends, and its duration [s]."""
    rate = np.polynomial.Polynomial([0.0, 1.0, -1.0]) ** n
    rise = (rate.integ() / rate.integ()(1.0)).coef / duration ** np.arange(2 * n + 2)
    coefficients = rise[:, np.newaxis, np.newaxis] * np.array([0.2, 0.02])
    coefficients[0] += np.array([-0.1, 0.32])
    return PiecewisePolynomial(np.array([0.0, duration]), coefficients)


@pytest.fixture(scope="module")
def motion() -> PiecewisePolynomial:
    return line(6, 0.16)


def designed(robot: Scene, motion: PiecewisePolynomial, knot_spacing: float = KNOT_SPACING) -> FlexibleReferences:
    """References for a motion."""
    return flexible_references(robot, motion, JointTrajectory(motion, RigidKinematics(robot.mechanism)), knot_spacing)


def followed(robot: Scene, motion: PiecewisePolynomial, design: FlexibleReferences) -> tuple[float, RealArray, float]:
    """Largest distance of the flexible end effector from where it should be [m], its end state, largest error of the torque [N m]."""
    joints = design.motors
    response = ElasticResponse([RobotVariant(robot)], joints.coefficients[0], 4 * joints.intervals)
    found = response.of_motion(joints, derivatives=False)
    time = response.fractions * joints.duration
    error = np.hypot(*(found.position[0] - motion.evaluate(time - LEAD, 0)[0]).T)
    torque = np.abs(found.torque[0] - design.torque(time))
    return float(error.max()), found.end[0], float(torque.max())


def test_the_flexible_robot_follows_the_motion(robot: Scene, motion: PiecewisePolynomial) -> None:
    """Rigid references leave hundreds of micrometres; with these the error falls with the fourth power of the knots' distance, and so
    does what is left of the vibration. Torques for a feedforward, tens of newton metres, are met to a millinewton metre."""
    designs = [designed(robot, motion, spacing) for spacing in (0.004, 0.002)]
    (coarse, *_), (fine, end, torque) = (followed(robot, motion, each) for each in designs)
    assert fine < 1e-9
    assert 3.5 < np.log2(coarse / fine) < 5.0
    assert torque < 1e-3
    # at rest before and after, with the end effector where it should be, by motor angles beside the rigid ones
    design, first = designs[1], designs[1].motors.coefficients[0]
    before, after = (design.model.rest(design.motors.coefficients[k]) for k in (0, -1))
    np.testing.assert_allclose(before.position[0], motion.rest[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(after.position[0], motion.rest[1], rtol=0, atol=1e-12)
    assert np.abs(end[0] - after.elastic[0]).max() < 1e-7
    assert np.abs(end[1]).max() < 1e-4
    np.testing.assert_allclose(design.torque(np.array([-1.0, 0.0])), [before.torque[0]] * 2, rtol=0, atol=1e-9)
    rigid = JointTrajectory(motion, RigidKinematics(robot.mechanism)).evaluate(0.0, 0)[0, 0]
    assert 2e-5 < np.abs(first - rigid).max() < 1e-3


def test_a_rigid_robot_gets_the_rigid_references(robot: Scene, motion: PiecewisePolynomial) -> None:
    """Without elastic coordinates what remains is inverse kinematics, at the knots to rounding."""
    stiff = robot.replace({"effects.proximal_bending": 0})
    design = designed(stiff, motion, 0.002)
    intervals = design.motors.intervals
    knots = np.arange(2, intervals - 1) / intervals
    rigid = JointTrajectory(motion, RigidKinematics(robot.mechanism))
    expected = rigid.evaluate(knots * design.motors.duration - LEAD, 0)[0]
    np.testing.assert_allclose(design.motors.evaluate(knots, 0)[0], expected, rtol=0, atol=1e-11)


def test_knots_that_are_too_few(robot: Scene, motion: PiecewisePolynomial) -> None:
    """The error names the key and a value that would do."""
    with pytest.raises(TrajectoryError, match=r"`knot_spacing` to 0\.016 s"):
        designed(robot, motion, 0.05)

"""Corrected references hold over a band of payloads, judged by integrating motion and standstill with others than those they are for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.reference_design.elastic_response import ElasticResponse
from flexfmu.model.reference_design.inverse_dynamics import LEAD, flexible_references
from flexfmu.model.reference_design.joint_spline import JointSpline
from flexfmu.model.reference_design.robust_correction import Tolerances, corrected
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import JointTrajectory
from flexfmu.trajectories.piecewise import PiecewisePolynomial

SEEN, OTHERS = ([{"payload.mass": float(mass)} for mass in np.linspace(4.2, 7.8, n)] for n in (16, 9))


@pytest.fixture(scope="module")
def motion(line: Callable[[int, float], PiecewisePolynomial]) -> PiecewisePolynomial:
    """The polynomial of degree 7 in time."""
    return line(3, 0.2)


@pytest.fixture(scope="module")
def nominal(robot: Scene, motion: PiecewisePolynomial) -> JointSpline:
    """References for 6 kg alone."""
    return flexible_references(robot, motion, JointTrajectory(motion, RigidKinematics(robot.mechanism))).motors


@pytest.fixture(scope="module")
def found(robot: Scene, motion: PiecewisePolynomial, nominal: JointSpline) -> JointSpline:
    """References for the band."""
    return corrected(robot, SEEN, nominal, motion, Tolerances())


def judged(robot: Scene, motion: PiecewisePolynomial, motors: JointSpline) -> tuple[float, float, RealArray]:
    """Largest residual vibration and distance from the path [m] of other payloads, and their peak torques (P, 2) [N m]."""
    still, steps = 0.05, 300
    response = ElasticResponse(robot, OTHERS, motors.coefficients[0], steps)
    whole = motors.duration + still
    time = response.fractions * whole
    moving = time <= motors.duration
    references = np.hstack(list(motors.evaluate(np.minimum(time / motors.duration, 1.0))))
    references[~moving, 2:] = 0.0
    run = response.respond(references, whole)
    rest = response.model.rest(motors.coefficients[-1]).position
    away = run.position - motion.evaluate(time - LEAD, 0)[0]
    rings = run.position[:, ~moving] - rest[:, np.newaxis]
    sizes = [float(np.hypot(*np.moveaxis(each, -1, 0)).max()) for each in (rings, away[:, moving])]
    return sizes[0], sizes[1], np.abs(run.torque).max(axis=1)


@pytest.mark.slow
def test_corrected_references_hold_for_the_band(
    robot: Scene, motion: PiecewisePolynomial, nominal: JointSpline, found: JointSpline
) -> None:
    """Payloads between those of the design vibrate as little, and stay as near to the path."""
    before, after = (judged(robot, motion, motors) for motors in (nominal, found))
    assert before[0] > 1e-6
    assert after[0] < 4e-7
    assert after[1] < max(9e-5, 1.2 * before[1])


def test_limits_of_torque_and_jerk_are_kept(
    robot: Scene, motion: PiecewisePolynomial, nominal: JointSpline, found: JointSpline
) -> None:
    """Less torque than the correction would take is possible, at more distance from the path or more vibration; corrections are
    some hundred microradians, at rest at both ends."""
    change = found.coefficients - nominal.coefficients
    assert 1e-6 < np.abs(change).max() < 1e-3
    np.testing.assert_array_equal(change[[0, 1, 2, 3, -4, -3, -2, -1]], 0.0)
    fractions = np.linspace(0.0, 1.0, 801)
    jerk = 0.98 * float(np.abs(found.evaluate(fractions, 3)[3]).max())
    limit = 0.997 * judged(robot, motion, found)[2].max(axis=0)
    few = SEEN[::5]
    limited = corrected(robot, few, nominal, motion, Tolerances(torque=np.tile(limit, (len(few), 1)), jerk=jerk))
    assert np.abs(limited.evaluate(fractions, 3)[3]).max() < 1.006 * jerk
    assert (judged(robot, motion, limited)[2].max(axis=0) < 1.006 * limit).all()


def test_impossible_wishes(robot: Scene, motion: PiecewisePolynomial, nominal: JointSpline) -> None:
    """A torque that the motion can't do without is told, with what could help."""
    with pytest.raises(TrajectoryError, match="torques within their limits"):
        corrected(robot, SEEN[:2], nominal, motion, Tolerances(torque=np.full((2, 2), 20.0)))

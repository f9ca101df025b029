"""Joint references with which the flexible end effector follows a motion, by spline collocation.

Unknowns are the motor angles and the elastic coordinates, all quintic splines on the same uniform knots, at rest at both ends.
At the knots the equations of the elastic motion hold, and the end effector is where the motion wants it; Newton's method solves
for all coefficients at once. The inverse dynamics are unstable in time (non-minimum phase), but a spline over the whole motion is
not integrated: it is the bounded solution, which moves a little before and after the end effector does.

Source: Devasia, Chen and Paden, Nonlinear inversion-based output tracking, IEEE Transactions on Automatic Control 41 (1996); U. M.
Ascher, R. M. M. Mattheij and R. D. Russell, *Numerical Solution of Boundary Value Problems for Ordinary Differential Equations*,
SIAM 1995, chapter 5 (collocation).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from scipy.sparse import bsr_array
from scipy.sparse.linalg import splu

from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.reference_design.elastic_response import RobotVariant, VariantModel
from flexfmu.model.reference_design.joint_spline import DEGREE, JointSpline, basis, rest_matrix
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.trajectory import Trajectory

LEAD = 0.002
"""Time [s] for which the joints may move before the end effector starts and after it has stopped. The slowest unstable zeros of a
five-bar lie near 1 kHz, so what it cuts off is e^-12 of the motion's own start."""

KNOT_SPACING = 0.002
"""Usual distance of the knots [s]."""

LEAST_INTERVALS = 10
"""Smallest number of intervals: fewer have hardly a free coefficient."""

CONVERGED = 1e-12
"""Newton's method has converged when no coefficient changes by more than this [rad, m]: the path is met to about 1 pm."""

ITERATIONS = 12
"""Largest number of Newton steps; four are usual."""


@dataclass(frozen=True, eq=False)
class FlexibleReferences:
    """References of the motors for a flexible robot.

    Attributes:
        model: the robot.
        motors: motor angles [rad] over the motion and `LEAD` before and after it.
        elastic: coefficients of the elastic coordinates, splines on the same knots, (intervals + `DEGREE`, n) [m, rad].
    """

    model: VariantModel
    motors: JointSpline
    elastic: RealArray

    @property
    def joints(self) -> PiecewisePolynomial:
        """Motion of the motors in time [rad]; it starts `LEAD` before the end effector."""
        return self.motors.trajectory()

    @property
    def largest_jerk(self) -> float:
        """Largest jerk of a motor [rad/s³]; jerks are parabolas between knots, so ten points an interval suffice."""
        fractions = np.linspace(0.0, 1.0, 10 * self.motors.intervals + 1)
        return float(np.abs(self.motors.evaluate(fractions, 3)[3]).max())

    def torque(self, time: RealArray) -> RealArray:
        """Motor torques [N m] at times (N,) [s] from the start of ``joints``, shape (N, 2); those at rest outside of it."""
        fractions = np.clip(np.asarray(time, dtype=float) / self.motors.duration, 0.0, 1.0)
        orders = [basis(self.motors.intervals, fractions, k) / self.motors.duration**k for k in range(3)]
        q, v, a = ((matrix @ self.elastic)[np.newaxis] for matrix in orders)
        references, n = np.hstack(list(self.motors.evaluate(fractions))), self.model.n
        return np.asarray(self.model.values(q, v, a, references)[0, :, n : n + 2])


@one_blas_thread()
def flexible_references(
    scene: Scene, motion: Trajectory, rigid: Trajectory, knot_spacing: float = KNOT_SPACING
) -> FlexibleReferences:
    """Design references of the motors such that the end effector of the flexible robot makes a motion.

    Args:
        scene: the robot, with its payload.
        motion: x and y [m] of the end effector, at rest before and after it.
        rigid: q11 and q21 [rad] with which the rigid robot makes this motion: the first guess.
        knot_spacing: largest distance of the splines' knots [s]. At the knots the end effector is where it should be; between
            them it errs by about the fourth power of the distance.

    Raises:
        TrajectoryError: the knots are too far apart for the motion, or no references make this motion.
    """
    # knots; the end effector is at rest at both ends, to the third derivative
    duration = motion.duration + 2.0 * LEAD
    intervals = ceil(duration / knot_spacing * (1.0 - 1e-9))
    if intervals < LEAST_INTERVALS:
        raise TrajectoryError(
            f"knots {knot_spacing:g} s apart are too few for references over {duration:g} s: at least {LEAST_INTERVALS} "
            f"intervals are needed, so reduce `knot_spacing` to {duration / LEAST_INTERVALS:.2g} s or less"
        )
    # rest at both ends, and so many knots between them as there are free coefficients
    knots = np.array([0, *range(2, intervals - 1), intervals]) / intervals
    times, rest = knots * duration - LEAD, rest_matrix(intervals + DEGREE)
    targets = motion.evaluate(times, 0)[0]
    matrices = np.array([basis(intervals, knots, k) @ rest / duration**k for k in range(3)])
    # equations for [elastic forces, end effector], with derivatives by [q_a, q_e], their rates and accelerations
    model = VariantModel([RobotVariant(scene)])
    n = model.n
    rows = np.array([*range(n), n + 2, n + 3])
    columns = np.hstack([np.arange(3 * n, 3 * n + 6).reshape(3, 2), np.arange(3 * n).reshape(3, n)])
    # of Newton's matrix: blocks of all values at a knot by all coefficients of one basis function
    row, column = np.nonzero(matrices[0])
    starts = np.searchsorted(row, np.arange(len(knots) + 1))
    # Newton's method over all coefficients, from the rigid robot's motion on
    free = np.zeros((len(knots), 2 + n))
    free[:, :2] = rigid.evaluate(np.clip(times, 0.0, rigid.duration), 0)[0]
    for _ in range(ITERATIONS):
        joints, (q, v, a) = np.split(matrices @ free, [2], axis=2)
        values, jacobian = model.linearised(q[np.newaxis], v[np.newaxis], a[np.newaxis], np.hstack(list(joints)))
        errors, by = values[0][:, rows], jacobian[0][:, rows[:, np.newaxis, np.newaxis], columns]
        errors[:, n:] -= targets
        blocks = np.einsum("ki,iakb->iab", matrices[:, row, column], by[row])
        change = splu(bsr_array((blocks, column, starts)).tocsc()).solve(errors.ravel()).reshape(free.shape)
        free -= change
        largest = np.abs(change).max()
        if not largest > CONVERGED:
            break
    if not largest <= CONVERGED:
        raise TrajectoryError(
            f"scene {scene.name}: no references of the motors make the flexible end effector follow the motion within "
            f"{duration:g} s; make it slower, or keep it away from singular poses"
        )
    found = rest @ free
    return FlexibleReferences(model, JointSpline(found[:, :2].copy(), duration), found[:, 2:].copy())

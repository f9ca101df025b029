"""Collocation of the elastic motion under joint references that are splines, in normalised time.

Unknowns are the elastic coordinates at the stages of Radau IIA in equal intervals. Rates and accelerations in normalised time t / T
are linear in them (derivatives of the collocation polynomials), joint angles and their derivatives are linear in the splines'
coefficients: every point's arguments z = [q, q', q'', q_a, q_a', q_a'', T] are a constant sparse matrix times the unknowns. So
Jacobian and Hessian of all constraints are blocks of single points between constant matrices, without colouring.

Source: J. T. Betts, *Practical Methods for Optimal Control*, SIAM 2010, chapter 4 (transcription, sparsity by points).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from flexfmu.model.numeric import numeric_model
from flexfmu.model.radau import Radau, radau
from flexfmu.model.reference_design.joint_spline import JointSpline, basis, rest_matrix
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium
from flexfmu.trajectories.jets import RealArray

Matrix: TypeAlias = Any
"""A sparse matrix of scipy."""

SETTLED = 1e-10
"""Newton step relative to the scales of the coordinates, below which the elastic motion is found."""

MOST_STEPS = 20
"""Newton iterations on the elastic motion; 3 or 4 are usual."""

SMALL = 1e-6
"""Scale of a coordinate relative to the largest one, at least."""


@dataclass(frozen=True)
class PointFunctions:
    """Equations at one point in time, with arguments z = [q, q', q'', q_a, q_a', q_a'', T].

    Attributes:
        n: number of elastic coordinates.
        values: z → [forces on elastic coordinates (n) [N], position (2) [m], torques (2) [N m]], shape (n + 4,).
        jacobian: z → (n + 4, 3 n + 7).
        effort: z → what the motors' effort at this point counts.
        hessian: (z, multipliers, weight) → Hessian of multipliers · values + weight effort, (3 n + 7, 3 n + 7).
    """

    n: int
    values: casadi.Function
    jacobian: casadi.Function
    effort: casadi.Function
    hessian: casadi.Function


Effort = Callable[[casadi.SX, casadi.SX], casadi.SX]
"""Torques (2) [N m] and joint speeds (2) [rad/s] at a point → what they count."""


@lru_cache(maxsize=16)
def point_functions(scene: Scene, effort: Effort | None = None) -> PointFunctions:
    """The equations at one point with exact derivatives; cached.

    Args:
        scene: the scene.
        effort: weight of the motors' effort; None to skip it.
    """
    model = numeric_model(scene)
    n = model.n
    # arguments in normalised time
    z = casadi.SX.sym("z", 3 * n + 7)
    ends = [0, n, 2 * n, 3 * n, 3 * n + 2, 3 * n + 4, 3 * n + 6, 3 * n + 7]
    q, rate, acceleration, angles, speeds, turns, duration = casadi.vertsplit(z, ends)
    u = casadi.vertcat(angles, speeds / duration, turns / duration**2)
    arguments = (q, rate / duration, acceleration / duration**2, u)
    # forces, position and torques, and their derivatives
    position, _, _, torque = model.motion(*arguments)
    values = casadi.cse(casadi.vertcat(model.elastic_forces(*arguments), position, torque))
    counts = casadi.SX(1, 1) if effort is None else effort(torque, speeds / duration)
    multipliers, weight = casadi.SX.sym("multipliers", n + 4), casadi.SX.sym("weight")
    hessian, _ = casadi.hessian(casadi.dot(multipliers, values) + weight * counts, z)
    return PointFunctions(
        n,
        casadi.Function("values", [z], [values]),
        casadi.Function("jacobian", [z], [casadi.cse(casadi.jacobian(values, z))]),
        casadi.Function("effort", [z], [casadi.densify(counts)]),
        casadi.Function("hessian", [z, multipliers, weight], [casadi.cse(hessian)]),
    )


@dataclass(frozen=True)
class CollocationGrid:
    """Intervals of the splines, and of the collocation in each motion.

    Attributes:
        splines: number of intervals of the splines.
        intervals: number of intervals of the collocation.
        stages: of Radau IIA in each of them; the order is 2 ``stages`` - 1.
        degree: of the splines.
    """

    splines: int = 28
    intervals: int = 28
    stages: int = 5
    degree: int = 5

    @property
    def method(self) -> Radau:
        """Radau IIA in each interval."""
        return radau(self.stages)

    @cached_property
    def points(self) -> RealArray:
        """Times of the stages as fractions of the duration, (K,)."""
        return np.asarray(((np.arange(self.intervals)[:, np.newaxis] + self.method.nodes) / self.intervals).ravel())

    @cached_property
    def weights(self) -> RealArray:
        """Weights of the stages in an integral over the normalised time, (K,)."""
        return np.tile(self.method.matrix[-1] / self.intervals, self.intervals)

    @cached_property
    def rest(self) -> RealArray:
        """Matrix from [start value, free coefficients, end value] of a joint to all its coefficients."""
        return rest_matrix(self.splines + self.degree)

    @property
    def free(self) -> int:
        """Number of free coefficients of both joints, 2 m."""
        return 2 * int(self.rest.shape[1] - 2)

    @cached_property
    def derivatives(self) -> tuple[Matrix, ...]:
        """Values, first and second derivatives at the stages, from values at the start and the stages, each (K, 1 + K).

        The motion starts at rest: the rate at the start is zero.
        """
        # derivatives at the stages of an interval, from values at its start and at the stages
        count, of_stages = self.stages * self.intervals, np.linalg.inv(self.method.matrix)
        slopes = np.hstack([-of_stages.sum(axis=1, keepdims=True), of_stages])
        # an interval's stages depend on them and on the last stage before it
        own = np.arange(self.stages + 1) + np.zeros((self.stages, 1), dtype=int)
        columns = (self.stages * np.arange(self.intervals)[:, np.newaxis, np.newaxis] + own).ravel()
        rows = np.repeat(np.arange(count), self.stages + 1)
        entries = np.tile(self.intervals * slopes.ravel(), self.intervals)
        first: Matrix = sparse.csr_matrix((entries, (rows, columns)), (count, count + 1))
        values: Matrix = sparse.hstack([sparse.csr_matrix((count, 1)), sparse.identity(count)])
        second: Matrix = first @ sparse.vstack([sparse.csr_matrix((1, count + 1)), first])
        return values.tocsr(), first, second.tocsr()


@dataclass(frozen=True, eq=False)
class Transcription:
    """A scene's equations at all stages; unknowns are [free coefficients of joint 1, of joint 2, T] and elastic coordinates.

    Attributes:
        scene: the scene.
        ends: joint angles at start and end [rad], (2, 2).
        scales: characteristic sizes of the elastic coordinates, by which the unknown ones are divided, (n,).
        grid: intervals and stages.
    """

    scene: Scene
    ends: RealArray
    scales: RealArray
    grid: CollocationGrid = CollocationGrid()

    @cached_property
    def functions(self) -> PointFunctions:
        """The equations at one point."""
        return point_functions(self.scene)

    @property
    def n(self) -> int:
        """Number of elastic coordinates."""
        return self.functions.n

    @cached_property
    def rest(self) -> RealArray:
        """Elastic coordinates in static equilibrium at start and end, (2, n)."""
        return np.array([static_equilibrium(self.scene, joints).elastic for joints in self.ends])

    @cached_property
    def lift(self) -> tuple[Matrix, Matrix, RealArray]:
        """Matrices and vector that make the arguments of all points: z = A [coefficients, T] + B [elastic / scales] + b."""
        grid, n, count = self.grid, self.n, len(self.grid.points)
        size, half = 3 * n + 7, grid.free // 2
        offset = np.zeros((count, size))
        of_elastic: Matrix = sparse.csr_matrix((count * size, count * n))
        of_joints: Matrix = sparse.csr_matrix((count * size, 2 * half + 1))
        at = size * np.arange(count)
        # elastic coordinates and their derivatives, from stages and the static start
        for k, operator in enumerate(grid.derivatives):
            offset[:, k * n : (k + 1) * n] = np.outer(operator[:, 0].toarray(), self.rest[0])
            rows = (at[:, np.newaxis] + k * n + np.arange(n)).ravel()
            block = sparse.kron(operator[:, 1:], sparse.diags(self.scales)) if n else sparse.csr_matrix((0, 0))
            of_elastic += _placed(block, rows, np.arange(count * n), of_elastic.shape)
        # joint angles and their derivatives, and the duration
        for k in range(3):
            values = basis(grid.degree, grid.splines, grid.points, k) @ grid.rest
            for joint in range(2):
                column = 3 * n + 2 * k + joint
                offset[:, column] = values[:, [0, -1]] @ self.ends[:, joint]
                columns = joint * half + np.arange(half)
                of_joints += _placed(values[:, 1:-1], at + column, columns, of_joints.shape)
        of_joints += _placed(np.ones((count, 1)), at + size - 1, np.array([2 * half]), of_joints.shape)
        return of_joints.tocsr(), of_elastic.tocsr(), offset.ravel()

    def joints(self, spline: JointSpline) -> RealArray:
        """The unknowns [free coefficients of joint 1, of joint 2, T] of a spline on this grid, (2 m + 1,)."""
        free = np.linalg.lstsq(self.grid.rest, spline.coefficients, rcond=None)[0][1:-1]
        return np.append(free.T.ravel(), spline.duration)

    def spline(self, joints: RealArray) -> JointSpline:
        """The spline of these unknowns."""
        free = joints[: self.grid.free].reshape(2, -1).T
        every = np.vstack([self.ends[:1], free, self.ends[1:]])
        return JointSpline(self.grid.rest @ every, float(joints[self.grid.free]), self.grid.degree)

    def arguments(self, joints: RealArray, elastic: RealArray) -> RealArray:
        """The arguments z of all points, (3 n + 7, K)."""
        of_joints, of_elastic, offset = self.lift
        z = of_joints @ joints + of_elastic @ elastic + offset
        return np.asarray(z.reshape(len(self.grid.points), -1).T)

    def values(self, z: RealArray) -> RealArray:
        """Elastic forces, position and torques for arguments of all points, (n + 4, K)."""
        return np.asarray(self.functions.values.map(z.shape[1])(z).full())

    def settled(self, joints: RealArray) -> RealArray:
        """Return the elastic coordinates / scales (K n,) that the joints' motion causes, by Newton's method.

        Raises:
            EquilibriumError: the iteration doesn't converge.
        """
        n, along = self.n, self.grid.points[:, np.newaxis]
        elastic = (((1 - along) * self.rest[0] + along * self.rest[1]) / self.scales).ravel()
        for _ in range(MOST_STEPS):
            if not n:
                return np.asarray(elastic)
            z = self.arguments(joints, elastic)
            # derivatives of the elastic forces of all points, side by side
            blocks = self.functions.jacobian.map(z.shape[1])(z)[:n, :]
            matrix: Matrix = casadi.diagcat(*casadi.horzsplit(blocks, 3 * n + 7)).sparse() @ self.lift[1]
            step = splu(matrix.tocsc()).solve(self.values(z)[:n].T.ravel())
            elastic = elastic - step
            if not np.isfinite(step).all():
                break
            if abs(step).max() < SETTLED * max(1.0, abs(elastic).max()):
                return np.asarray(elastic)
        raise EquilibriumError(
            f"the elastic motion under the joints' motion isn't found within {MOST_STEPS} iterations"
        )


def _placed(block: Matrix, rows: NDArray[np.int_], columns: NDArray[np.int_], shape: tuple[int, int]) -> Matrix:
    """A matrix of a shape with a block at these rows and columns."""
    entries: Matrix = sparse.coo_matrix(block)
    return sparse.csr_matrix((entries.data, (rows[entries.row], columns[entries.col])), shape)


def transcribed(scene: Scene, spline: JointSpline, grid: CollocationGrid) -> Transcription:
    """The scene's equations, scaled by the elastic motion that a motion on the grid's splines causes.

    Raises:
        EquilibriumError: there is no static equilibrium or no elastic motion.
    """
    ends = spline.coefficients[[0, -1]]
    unscaled = Transcription(scene, ends, np.ones(numeric_model(scene).n), grid)
    found = abs(unscaled.settled(unscaled.joints(spline)).reshape(len(grid.points), unscaled.n)).max(axis=0)
    return Transcription(scene, ends, np.maximum(found, SMALL * found.max(initial=0.0)), grid)

"""Constraints of optimal control with exact first and second derivatives: robots at all points in time, and references.

Every nonlinear function belongs to a single point in time: Jacobian and Hessian are blocks of points between the constant matrices of
`transcription`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi
import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.reference_design.joint_spline import JointSpline, basis
from flexfmu.model.reference_design.transcription import Effort, Matrix, Transcription, point_functions
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray

MESH = 1 / 40
"""Distance between points at which distances are tabulated, relative to the area's shorter side."""


@dataclass(frozen=True, eq=False)
class RobotLimits:
    """A robot that the motion shall suit.

    Attributes:
        scene: the robot with its payload.
        torque: largest magnitudes of the motor torques [N m], (2,).
        residual: largest residual vibration [m].
    """

    scene: Scene
    torque: RealArray
    residual: float = 1e-6


@dataclass(frozen=True)
class ReferenceLimits:
    """Largest magnitudes of the joints' speed [rad/s], acceleration [rad/s²] and jerk [rad/s³]."""

    speed: float
    acceleration: float
    jerk: float

    @property
    def values(self) -> tuple[float, float, float]:
        """All three."""
        return self.speed, self.acceleration, self.jerk

    def used(self, spline: JointSpline) -> list[float]:
        """Largest values of a motion, relative to the limits."""
        moving = spline.evaluate(np.linspace(0.0, 1.0, 100 * spline.intervals + 1), 3)[1:]
        return [float(abs(each).max() / limit) for each, limit in zip(moving, self.values, strict=True)]

    def divided(self, shares: Sequence[float]) -> ReferenceLimits:
        """Limits divided by factors."""
        return ReferenceLimits(*(limit / share for limit, share in zip(self.values, shares, strict=True)))


@dataclass(frozen=True, eq=False)
class Area:
    """Where the end effector may go: a rectangle in a frame, less regions.

    Attributes:
        origin: of the frame [m], (2,).
        axes: unit vectors of the frame's coordinates, in rows (2, 2).
        low, high: corners of the rectangle in the frame [m], (2,).
        distances: of points (N, 2) [m] from each region, (N,) [m], negative inside.
        margin: depth by which the end effector may enter a region [m].
    """

    origin: RealArray
    axes: RealArray
    low: RealArray
    high: RealArray
    distances: tuple[Callable[[RealArray], RealArray], ...] = ()
    margin: float = 1e-4

    @property
    def scale(self) -> float:
        """The rectangle's shorter side [m]."""
        return float(min(self.high - self.low))

    @cached_property
    def smooth(self) -> tuple[casadi.Function, ...]:
        """A cubic spline through each region's distances: point in the frame / scale → distance / scale."""
        return tuple(self._smooth(distance) for distance in self.distances)

    def _smooth(self, distance: Callable[[RealArray], RealArray]) -> casadi.Function:
        step = MESH * self.scale
        axes = [
            np.linspace(low - 3 * step, high + 3 * step, 7 + int((high - low) / step))
            for low, high in zip(self.low, self.high, strict=True)
        ]
        mesh = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        values = distance(self.origin + mesh @ self.axes).reshape([len(axis) for axis in axes])
        table = casadi.interpolant("table", "bspline", [axis.tolist() for axis in axes], values.ravel(order="F"))
        point = casadi.MX.sym("point", 2)
        return casadi.Function("distance", [point], [table(self.scale * point) / self.scale])


SAMPLES = (4, 4, 8)
"""Points in each interval of the splines at which speed, acceleration and jerk are limited."""

REMAINING = 0.02
"""Vibration of a mode at the end of the motion, as a fraction of the residual vibration that is allowed."""

FAINT = 0.05
"""Displacement of the end effector by a mode, relative to the largest one, at least."""


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints, their derivatives by [joints, T] and by own unknowns, bounds; and second derivatives with multipliers.

    Attributes:
        values, by_joints, by_own: constraints (R) and Jacobians.
        lower, upper: their bounds (R,).
        effort: what the motors' effort counts in the objective.
        hessian: (multipliers, weight of the effort) → blocks by joints, by joints and own, and by own unknowns.
    """

    values: casadi.MX
    by_joints: casadi.MX
    by_own: casadi.MX
    lower: RealArray
    upper: RealArray
    effort: casadi.MX
    hessian: Callable[[casadi.MX, casadi.MX], tuple[casadi.MX, casadi.MX, casadi.MX]]


def robot_rows(
    equations: Transcription,
    robot: RobotLimits,
    area: Area,
    effort: tuple[Effort | None, float],
    joints: casadi.MX,
    own: casadi.MX,
) -> Constraints:
    """Constraints of a robot: equations of motion, position and torques, regions, and the end without vibration."""
    regions = area.smooth
    n, count, functions = equations.n, len(equations.grid.points), point_functions(equations.scene, effort[0])
    elastic, place = own[: count * n], casadi.reshape(own[count * n :], 2, count)
    of_joints, of_elastic, offset = (constant(each) for each in equations.lift)
    z = casadi.reshape(of_joints @ joints + of_elastic @ elastic + offset, 3 * n + 7, count)
    # at every point: forces, place in the frame, torques
    scaling = constant(_scaling(equations, robot, area))
    shift = casadi.vertcat(casadi.DM(n, 1), area.axes @ area.origin / area.scale, casadi.DM(2, 1))
    pad = constant(sparse.csr_matrix((np.ones(2), ([n, n + 1], [0, 1])), (n + 4, 2)))
    values = scaling @ functions.values.map(count)(z) - pad @ place - casadi.repmat(shift, 1, count)
    blocks = casadi.kron(casadi.DM.eye(count), scaling) @ _diagonal(functions.jacobian.map(count)(z), count)
    of_place = casadi.kron(casadi.DM.eye(count), -pad)
    # regions, and the vibration at the end
    depths = [_mapped(region, count) for region in regions]
    last_joints, last_elastic, last = _end_rows(equations, robot)
    end = last_joints @ joints + last_elastic @ elastic + last[:, 0]
    kept = [depth(place).T for depth, _, _ in depths]
    by_elastic = casadi.vertcat(blocks @ of_elastic, casadi.MX(len(regions) * count, count * n), last_elastic)
    by_place = casadi.vertcat(
        of_place, *(_diagonal(slope(place), count) for _, slope, _ in depths), casadi.MX(end.numel(), 2 * count)
    )
    weights = equations.grid.weights / effort[1]

    def hessian(multipliers: casadi.MX, weight: casadi.MX) -> tuple[casadi.MX, casadi.MX, casadi.MX]:
        of_point, *of_region, _ = casadi.vertsplit(
            multipliers, np.cumsum([0, (n + 4) * count, *(count for _ in regions), end.numel()]).tolist()
        )
        mu = scaling.T @ casadi.reshape(of_point, n + 4, count)
        second = _diagonal(functions.hessian.map(count)(z, mu, weight * weights[np.newaxis]), count)
        curved = [_diagonal(curve(place, mu.T), count) for (_, _, curve), mu in zip(depths, of_region, strict=True)]
        right = second @ of_elastic
        blocks = casadi.diagcat(of_elastic.T @ right, sum(curved, casadi.MX(2 * count, 2 * count)))
        return (
            of_joints.T @ (second @ of_joints),
            casadi.horzcat(of_joints.T @ right, casadi.MX(joints.numel(), 2 * count)),
            blocks,
        )

    lowest = [np.full(count, -area.margin / area.scale) for _ in regions]
    allowed = np.concatenate([np.zeros(n + 2), np.ones(2)])
    return Constraints(
        casadi.vertcat(casadi.vec(values), *kept, end),
        casadi.vertcat(blocks @ of_joints, casadi.MX(len(regions) * count, joints.numel()), last_joints),
        casadi.horzcat(by_elastic, by_place),
        np.concatenate([np.tile(-allowed, count), *lowest, np.array(last[:, 1]).ravel()]),
        np.concatenate(
            [np.tile(allowed, count), *(np.full(count, np.inf) for _ in regions), np.array(last[:, 2]).ravel()]
        ),
        casadi.dot(functions.effort.map(count)(z), weights[np.newaxis]),
        hessian,
    )


def _scaling(equations: Transcription, robot: RobotLimits, area: Area) -> Matrix:
    """Matrix that scales forces by what a characteristic deflection needs, places to the frame, torques by their limits."""
    model = numeric_model(equations.scene)
    stiffness = model.static_stiffness(equations.rest[1], standstill(equations.ends[1])).full()
    forces = sparse.diags(1.0 / (np.abs(np.diag(stiffness)) * equations.scales))
    return sparse.block_diag([forces, area.axes / area.scale, np.diag(1.0 / robot.torque)])


def _end_rows(equations: Transcription, robot: RobotLimits) -> tuple[casadi.DM, casadi.DM, casadi.DM]:
    """Constraints on the last point for each mode: displacement, and rate / frequency within the duration times a bound.

    They are relative to the largest vibration that may remain.

    Returns:
        Matrices of [joints, T] and of the elastic coordinates, and [constants, lower, upper bounds].
    """
    n = equations.n
    of_joints, of_elastic, offset = equations.lift
    first = len(offset) - (3 * n + 7)
    place, rate = slice(first, first + n), slice(first + n, first + 2 * n)
    projection, frequencies = modal_displacements(equations.scene, equations.ends[1], equations.rest[1])
    unit = REMAINING * robot.residual
    modal, rates = projection / unit, projection / (frequencies[:, np.newaxis] * unit)
    # rates in normalised time: |rate| <= T unit
    time = sparse.csr_matrix((np.ones(n), (np.arange(n), np.full(n, of_joints.shape[1] - 1))), (n, of_joints.shape[1]))
    matrix = np.vstack([modal, np.zeros_like(modal), np.zeros_like(modal)]), np.vstack([0 * modal, rates, -rates])
    joints = sparse.csr_matrix(matrix[0]) @ of_joints[place] + sparse.csr_matrix(matrix[1]) @ of_joints[rate]
    joints -= sparse.vstack([sparse.csr_matrix(time.shape), time, time])
    elastic = sparse.csr_matrix(matrix[0]) @ of_elastic[place] + sparse.csr_matrix(matrix[1]) @ of_elastic[rate]
    fixed = matrix[0] @ (offset[place] - equations.rest[1]) + matrix[1] @ offset[rate]
    lower = np.concatenate([-np.ones(n), np.full(2 * n, -np.inf)])
    upper = np.concatenate([np.ones(n), np.zeros(2 * n)])
    return constant(joints), constant(elastic), casadi.DM(np.stack([fixed, lower, upper], axis=1))


def modal_displacements(scene: Scene, joints: RealArray, elastic: RealArray) -> tuple[RealArray, RealArray]:
    """Matrix (n, n) from elastic coordinates to displacements of the end effector by each mode [m], and frequencies [rad/s], (n,).

    Modes are those of small vibrations about static equilibrium; modes that hardly move the end effector count as if they moved
    it by `FAINT` of the largest displacement.
    """
    model, u = numeric_model(scene), standstill(joints)
    if not model.n:
        return np.zeros((0, 0)), np.zeros(0)
    stiffness, mass = model.static_stiffness(elastic, u).full(), model.mass_matrix(elastic, u).full()
    squares, shapes = eigh(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T))
    # the end effector by elastic coordinates
    q, zeros = casadi.SX.sym("q", model.n), np.zeros(model.n)
    moves = casadi.Function("moves", [q], [casadi.jacobian(model.motion(q, zeros, zeros, u)[0], q)])(elastic).full()
    sizes = np.linalg.norm(moves @ shapes, axis=0)
    return np.maximum(sizes, FAINT * sizes.max())[:, np.newaxis] * (shapes.T @ mass), np.sqrt(squares)


def reference_rows(
    equations: Transcription, limits: ReferenceLimits, duration: float, joints: casadi.MX
) -> Constraints:
    """Constraints on speed, acceleration and jerk of both joints: |derivative| <= limit (T / duration)^k in normalised time."""
    grid = equations.grid
    half, matrices, offsets, orders = grid.free // 2, list[Matrix](), list[RealArray](), list[RealArray]()
    for order, (limit, samples) in enumerate(zip(limits.values, SAMPLES, strict=True), 1):
        points = np.linspace(0.0, 1.0, samples * grid.splines + 1)[1:-1]
        values = basis(grid.degree, grid.splines, points, order) @ grid.rest / (limit * duration**order)
        both: Matrix = sparse.block_diag([values[:, 1:-1]] * 2)
        free: Matrix = sparse.vstack([both, -both])
        ends = (values[:, [0, -1]] @ equations.ends).T.ravel()
        matrices.append(sparse.hstack([free, sparse.csr_matrix((free.shape[0], 1))]))
        offsets.append(np.concatenate([ends, -ends]))
        orders.append(np.full(free.shape[0], order))
    matrix, offset, power = (
        casadi.MX(constant(sparse.vstack(matrices))),
        np.concatenate(offsets),
        np.concatenate(orders),
    )
    time_scale, last = joints[-1] / duration, constant(sparse.csr_matrix(([1.0], ([0], [2 * half])), (1, 2 * half + 1)))
    slope = power * time_scale ** (power - 1) / duration

    def hessian(multipliers: casadi.MX, _: casadi.MX) -> tuple[casadi.MX, casadi.MX, casadi.MX]:
        curve = casadi.dot(multipliers, power * (power - 1) * time_scale ** np.maximum(power - 2, 0)) / duration**2
        return last.T @ (-curve) @ last, casadi.MX(), casadi.MX()

    return Constraints(
        matrix @ joints + offset - time_scale**power,
        matrix - slope @ last,
        casadi.MX(),
        np.full(len(power), -np.inf),
        np.zeros(len(power)),
        casadi.MX(1, 1),
        hessian,
    )


def _mapped(function: casadi.Function, count: int) -> tuple[casadi.Function, casadi.Function, casadi.Function]:
    """Values, gradients and upper Hessians x multiplier of a function of a point, at all points."""
    point, mu = casadi.MX.sym("point", 2), casadi.MX.sym("mu")
    value = function(point)
    slope = casadi.Function("slope", [point], [casadi.jacobian(value, point)])
    curve = casadi.Function("curve", [point, mu], [casadi.hessian(mu * value, point)[0]])
    return function.map(count), slope.map(count), curve.map(count)


def _diagonal(blocks: casadi.MX, count: int) -> casadi.MX:
    """The block diagonal matrix of blocks that stand side by side."""
    return casadi.diagcat(*casadi.horzsplit(blocks, blocks.shape[1] // count))


def constant(matrix: Matrix) -> casadi.DM:
    """A sparse matrix as CasADi's."""
    if isinstance(matrix, np.ndarray):
        return casadi.DM(matrix)
    columns = sparse.csc_matrix(matrix)
    columns.sort_indices()
    return casadi.DM(columns)

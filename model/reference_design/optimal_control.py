"""Optimal control of the flexible robot: joint references with free end time, within limits, from rest to rest.

Joint angles are B-splines, the elastic motion of one or several robots under them is collocated (`transcription`), and IPOPT
minimises time or effort with exact derivatives. Constraints: equations of motion, torques, end effector in its area, speed,
acceleration and jerk of the joints, no vibration of any mode at the end. A coarse grid finds the motion, a fine one corrects it, and
what exceeds a limit between the points is taken off the limit for a last correction.

Unknowns are [free coefficients of joint 1, of joint 2, T], and for each robot its elastic coordinates / scales and its end effector in
the area's frame. Every nonlinear function belongs to a single point in time; see `transcription`.

All that is scaled is scaled by the given motion. Sources: A. Waechter and L. T. Biegler, Mathematical Programming 106 (2006)
(IPOPT); J. T. Betts, *Practical Methods for Optimal Control*, SIAM 2010, chapter 4.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import current_thread, main_thread
from typing import Any, Literal

import casadi
import numpy as np
from scipy import sparse
from scipy.interpolate import CubicSpline

from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.reference_design.control_rows import (
    Area,
    ReferenceLimits,
    RobotLimits,
    constant,
    reference_rows,
    robot_rows,
)
from flexfmu.model.reference_design.joint_spline import JointSpline, basis, fitted
from flexfmu.model.reference_design.transcription import CollocationGrid, Effort, Matrix, Transcription, transcribed
from flexfmu.trajectories.jets import RealArray

Aim = Literal["time", "torque", "rms_torque", "energy", "residual"]
"""What is minimised; all but time at a given duration. The aim "residual" is a motion without any at the least torques."""

SMOOTHING = 0.03
"""Weight of the joints' squared jerk in normalised time, relative to the start's: it selects one of many motions that cost the same."""

ROUNDING = 0.05
"""Power within which the corner at zero is rounded, relative to the largest torque x the largest speed of the start."""

PEAK = 8
"""Power whose mean stands for a peak."""

GROWTH = (0.1, 1.5)
"""Bounds of a free duration, relative to the start's."""


class MotionProgramme:
    """The programme for robots that share a motion, all on the same grid.

    Args:
        transcriptions: equations of the robots.
        robots: the robots.
        limits: of the joints' references.
        area: where the end effector may go.
        start: the motion by which the objective is scaled, on the grid's splines.
        aim: what is minimised.
    """

    def __init__(
        self,
        transcriptions: Sequence[Transcription],
        robots: Sequence[RobotLimits],
        limits: ReferenceLimits,
        area: Area,
        start: JointSpline,
        aim: Aim = "time",
    ) -> None:
        self.transcriptions, self.grid, self.area, self._scale = transcriptions, transcriptions[0].grid, area, start
        # the unknowns: joints and duration, then robot by robot
        joints = casadi.MX.sym("joints", self.grid.free + 1)
        sizes = [len(self.grid.points) * (each.n + 2) for each in transcriptions]
        own = [casadi.MX.sym("own", size) for size in sizes]
        parts = [
            robot_rows(each, robot, area, _effort(aim, start, robot), joints, unknowns)
            for each, robot, unknowns in zip(transcriptions, robots, own, strict=True)
        ]
        rows = [reference_rows(transcriptions[0], limits, start.duration, joints), *parts]
        self._bounds = [np.concatenate(each) for each in zip(*((row.lower, row.upper) for row in rows), strict=True)]
        # objective: time or effort, and a smooth motion
        smooth, quadratic = _smoothness(transcriptions[0], joints, start)
        time = aim == "time"
        efforts = [0.0 if time else part.effort / len(parts) for part in parts]
        objective = SMOOTHING * smooth + (joints[-1] / start.duration if time else sum(efforts))
        # constraints and their Jacobian
        x, g = casadi.vertcat(joints, *own), casadi.vertcat(*(row.values for row in rows))
        by_own = casadi.vertcat(
            casadi.MX(rows[0].values.numel(), sum(sizes)), casadi.diagcat(*(row.by_own for row in parts))
        )
        jacobian = casadi.horzcat(casadi.vertcat(*(row.by_joints for row in rows)), by_own)
        # Hessian of the Lagrangian, upper triangle
        weight, multipliers = casadi.MX.sym("weight"), casadi.MX.sym("multipliers", g.numel())
        of_row = casadi.vertsplit(multipliers, np.cumsum([0, *(row.values.numel() for row in rows)]).tolist())
        blocks = [row.hessian(mu, weight / len(parts)) for row, mu in zip(rows, of_row, strict=True)]
        corner = weight * SMOOTHING * quadratic + sum(block[0] for block in blocks)
        hessian = casadi.vertcat(
            casadi.horzcat(corner, *(block[1] for block in blocks[1:])),
            casadi.horzcat(casadi.MX(sum(sizes), joints.numel()), casadi.diagcat(*(block[2] for block in blocks[1:]))),
        )
        nothing = casadi.MX.sym("p", 0)
        self.problem: dict[str, Any] = {"x": x, "f": objective, "g": g}
        self.gradient = casadi.Function("gradient", [x], [casadi.gradient(objective, x).T])
        self.derivatives: dict[str, Any] = {
            "jac_g": casadi.Function("nlp_jac_g", [x, nothing], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": casadi.Function(
                "nlp_hess_l", [x, nothing, weight, multipliers], [casadi.triu(hessian)],
                ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"],
            ),
        }  # fmt: skip

    def start(self, spline: JointSpline) -> RealArray:
        """The unknowns of a motion on the grid's splines, with the elastic motion that it causes."""
        found = [self.transcriptions[0].joints(spline)]
        for each in self.transcriptions:
            elastic = each.settled(found[0])
            position = each.values(each.arguments(found[0], elastic))[each.n : each.n + 2].T
            found += [elastic, ((position - self.area.origin) @ self.area.axes.T / self.area.scale).ravel()]
        return np.concatenate(found)

    def bounds(self, duration: float | None) -> dict[str, RealArray]:
        """Bounds of unknowns and constraints, with a free duration or a given one [s]."""
        count, scale, free = len(self.grid.points), self.area.scale, self.grid.free
        lower, upper = np.full(free + 1, -np.inf), np.full(free + 1, np.inf)
        times = np.array(GROWTH) * self._scale.duration if duration is None else (duration, duration)
        lower[-1], upper[-1] = times
        margin = self.area.margin
        for each in self.transcriptions:
            loose = np.full(count * each.n, np.inf)
            lower = np.concatenate([lower, -loose, np.tile((self.area.low - margin) / scale, count)])
            upper = np.concatenate([upper, loose, np.tile((self.area.high + margin) / scale, count)])
        return {"lbx": lower, "ubx": upper, "lbg": self._bounds[0], "ubg": self._bounds[1]}

    def spline(self, x: RealArray) -> JointSpline:
        """The joints' motion of unknowns."""
        return self.transcriptions[0].spline(x[: self.grid.free + 1])


def _smoothness(equations: Transcription, joints: casadi.MX, start: JointSpline) -> tuple[casadi.MX, casadi.DM]:
    """Mean squared jerk of both joints in normalised time / that of the start, and its Hessian by [joints, T]."""
    grid = equations.grid
    nodes, weights = np.polynomial.legendre.leggauss(grid.degree - 2)
    points = ((np.arange(grid.splines)[:, np.newaxis] + 0.5 + 0.5 * nodes) / grid.splines).ravel()
    roots = np.sqrt(np.tile(0.5 * weights / grid.splines, grid.splines))[:, np.newaxis]
    values = roots * (basis(grid.degree, grid.splines, points, 3) @ grid.rest)
    scale = np.linalg.norm(roots[:, :, np.newaxis] * start.evaluate(points, 3)[3][:, np.newaxis]) * start.duration**3
    # jerk / scale at Gauss' points: its square is the integral
    both: Matrix = sparse.block_diag([values[:, 1:-1] / scale] * 2)
    matrix = constant(sparse.hstack([both, sparse.csr_matrix((2 * len(points), 1))]))
    jerk = matrix @ joints + (values[:, [0, -1]] @ equations.ends).T.ravel() / scale
    return casadi.sumsqr(jerk), 2.0 * matrix.T @ matrix


def _effort(aim: Aim, start: JointSpline, robot: RobotLimits) -> tuple[Effort | None, float]:
    """What the motors' effort counts, and its scale."""
    size = float(max(robot.torque))
    if aim == "time":
        return None, 1.0
    if aim == "energy":
        speed = float(abs(start.evaluate(np.linspace(0.0, 1.0, 200), 1)[1]).max())
        return _GivenPower(ROUNDING * size * speed), size * speed
    return (_peak, size**PEAK) if aim == "torque" else (_square, size**2)


def _square(torque: casadi.SX, speed: casadi.SX) -> casadi.SX:
    return casadi.sumsqr(torque)


def _peak(torque: casadi.SX, speed: casadi.SX) -> casadi.SX:
    return casadi.sum1(torque**PEAK)


@dataclass(frozen=True)
class _GivenPower:
    """Power that the motors give, without what they take back; the corner at zero is rounded [W], since IPOPT needs curvature."""

    rounding: float

    def __call__(self, torque: casadi.SX, speed: casadi.SX) -> casadi.SX:
        power = torque * speed
        return casadi.sum1(0.5 * (power + casadi.sqrt(power**2 + self.rounding**2)))


COARSE, FINE = CollocationGrid(intervals=30, stages=3), CollocationGrid()
"""Grids that find and that correct a motion: 10 and 0.1 µm of residual vibration by their errors on the shipped robot."""

CHECK = CollocationGrid(intervals=56)
"""Grid on which limits are checked between the points, by splines through its points."""

DENSE = 2000
"""Points of these splines."""

OPTIONS: dict[str, Any] = {
    "print_time": False,
    "calc_lam_p": False,
    "calc_f": False,
    "ipopt.sb": "yes",
    "ipopt.print_level": 0,
    "ipopt.linear_solver": "mumps",
    "ipopt.mumps_pivtol": 1e-3,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.max_iter": 120,
    "ipopt.max_cpu_time": 40.0,
}
"""Of IPOPT through CasADi. MUMPS' default pivoting fails on these equations."""

FIND: dict[str, Any] = {"ipopt.mu_strategy": "adaptive", "ipopt.mu_init": 1e-2, "ipopt.tol": 1e-4}
"""To find a motion, far from the optimum."""

CAREFUL: dict[str, Any] = {"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-1, "ipopt.tol": 1e-4}
"""The same, slower, where the first doesn't converge."""

PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")

CORRECT: dict[str, Any] = {f"ipopt.{key}": 1e-5 for key in PUSHES} | {
    "ipopt.mu_strategy": "monotone",
    "ipopt.mu_init": 1e-5,
    "ipopt.tol": 1e-5,
}
"""To correct a motion that is nearly optimal."""

CORRECTIONS = 3
"""Solutions on the fine grid, at most."""

SURE = 1.001
"""Factor on what a motion exceeds limits by."""

ENOUGH = 1e-5
"""Relative excess over a limit that needs no correction."""


@dataclass(frozen=True, eq=False)
class OptimalMotion:
    """A motion on the way to the optimum.

    Attributes:
        spline: the joints' motion.
        grid: the grid that its equations are solved on.
        converged: whether IPOPT found an optimum.
        status: IPOPT's outcome.
    """

    spline: JointSpline
    grid: CollocationGrid
    converged: bool
    status: str


@one_blas_thread()
def optimal_motions(
    robots: Sequence[RobotLimits],
    limits: ReferenceLimits,
    area: Area,
    start: JointSpline,
    aim: Aim = "time",
    duration: float | None = None,
    grids: tuple[CollocationGrid, CollocationGrid] = (COARSE, FINE),
) -> Iterator[OptimalMotion]:
    """Yield optimal motions: from a coarse grid, from a fine one, and with limits that hold between its points.

    Args:
        robots: the robots that share the motion, with their limits.
        limits: of the joints' references.
        area: where the end effector may go.
        start: the given motion, or a better one; it is stretched where it violates limits.
        aim: what to minimise.
        duration: duration of the motion [s]; None for a free one, which the aim "time" needs.
        grids: that find and that correct the motion, with the same splines.

    Raises:
        EquilibriumError: there is no static equilibrium or no elastic motion.
    """
    coarse, fine = grids
    if (start.intervals, start.degree) != (coarse.splines, coarse.degree):
        start = fitted(start.trajectory(), coarse.splines, coarse.degree)
    # find the motion on the coarse grid
    first = stretched(start, limits) if duration is None else start.with_duration(duration)
    programme = MotionProgramme(_transcriptions(robots, first, coarse), robots, limits, area, first, aim)
    found = _solved(programme, first, duration, FIND)
    if not found.converged and duration is None:
        found = _solved(programme, first, duration, CAREFUL)
    yield found
    if not found.converged:
        return
    # correct it on the fine grid, then for what exceeds limits between its points
    tight = robots, limits, area
    for _ in range(CORRECTIONS):
        programme = MotionProgramme(_transcriptions(robots, found.spline, fine), *tight, first, aim)
        corrected = _solved(programme, found.spline, duration, CORRECT)
        if not corrected.converged:
            corrected = _solved(programme, found.spline, duration, FIND)
        if not corrected.converged:
            return
        found = corrected
        yield found
        # what exceeds limits between the points is taken off them
        torques, depths = zip(*(_checked(robot, area, found.spline) for robot in robots), strict=True)
        used, depth = limits.used(found.spline), max(depths)
        shares = [torque / robot.torque for torque, robot in zip(torques, robots, strict=True)]
        if max(*used, *(share.max() for share in shares), depth / area.margin) < 1.0 + ENOUGH:
            return
        tight = (
            [
                replace(each, torque=each.torque / np.maximum(1.0, SURE * share))
                for each, share in zip(tight[0], shares, strict=True)
            ],
            tight[1].divided([max(1.0, SURE * share) for share in used]),
            replace(tight[2], margin=tight[2].margin - max(0.0, SURE * depth - area.margin)),
        )


def stretched(spline: JointSpline, limits: ReferenceLimits) -> JointSpline:
    """Return the motion, slower by 10 % or as its speed, acceleration and jerk need to keep to their limits."""
    used = limits.used(spline)
    return spline.with_duration(spline.duration * max(1.1, *(share ** (1 / k) for k, share in enumerate(used, 1))))


def _transcriptions(robots: Sequence[RobotLimits], spline: JointSpline, grid: CollocationGrid) -> list[Transcription]:
    return [transcribed(robot.scene, spline, grid) for robot in robots]


def _solved(
    programme: MotionProgramme, start: JointSpline, duration: float | None, options: dict[str, Any]
) -> OptimalMotion:
    """IPOPT's result from a first motion."""
    solver = casadi.nlpsol("motion", "ipopt", programme.problem, OPTIONS | programme.derivatives | options)
    with _ctrl_c_afterwards():
        found = solver(x0=programme.start(start), **programme.bounds(duration))
    stats = solver.stats()
    return OptimalMotion(
        programme.spline(np.array(found["x"]).ravel()),
        programme.grid,
        bool(stats["success"]),
        str(stats["return_status"]),
    )


@contextmanager
def _ctrl_c_afterwards() -> Iterator[None]:
    """Raise KeyboardInterrupt after IPOPT's seconds: within them CasADi takes it for a failed evaluation and goes on."""
    usual, seen = signal.getsignal(signal.SIGINT), list[int]()
    if current_thread() is not main_thread() or not callable(usual):
        yield
        return
    signal.signal(signal.SIGINT, lambda number, _: seen.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
    if seen:
        raise KeyboardInterrupt


def _checked(robot: RobotLimits, area: Area, spline: JointSpline) -> tuple[RealArray, float]:
    """Largest torques (2,) [N m], and depth of the end effector in a region [m], of a motion between the points of a grid."""
    # the motion on a fine grid
    grid = replace(CHECK, splines=spline.intervals, degree=spline.degree)
    equations = transcribed(robot.scene, spline, grid)
    joints = equations.joints(spline)
    outputs = equations.values(equations.arguments(joints, equations.settled(joints)))[-4:]
    # splines through its outputs
    dense = CubicSpline(grid.points, outputs, axis=1)(np.linspace(grid.points[0], 1.0, DENSE))
    depths = [-each(dense[:2].T).min() for each in area.distances]
    return abs(dense[2:]).max(axis=1), max(depths, default=0.0)

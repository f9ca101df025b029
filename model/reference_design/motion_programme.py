"""The nonlinear programme of optimal control: unknowns, constraints, exact Jacobian and Hessian, bounds.

Unknowns are [free coefficients of joint 1, of joint 2, T], and for each robot its elastic coordinates / scales and its end effector in
the area's frame. Every nonlinear function belongs to a single point in time; see `transcription`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import casadi
import numpy as np
from scipy import sparse

from flexfmu.model.reference_design.control_limits import Area, ReferenceLimits, Robot
from flexfmu.model.reference_design.control_rows import constant, reference_rows, robot_rows
from flexfmu.model.reference_design.joint_spline import JointSpline, basis
from flexfmu.model.reference_design.transcription import Effort, Matrix, Transcription
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
        robots: Sequence[Robot],
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


def _effort(aim: Aim, start: JointSpline, robot: Robot) -> tuple[Effort | None, float]:
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

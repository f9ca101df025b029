"""Optimal control of the flexible robot: joint references with free end time, within limits, from rest to rest.

Joint angles are B-splines, the elastic motion of one or several robots under them is collocated (`transcription`), and IPOPT
minimises time or effort with exact derivatives. Constraints: equations of motion, torques, end effector in its area, speed,
acceleration and jerk of the joints, no vibration of any mode at the end. A coarse grid finds the motion, a fine one corrects it, and
what exceeds a limit between the points is taken off the limit for a last correction.

All that is scaled is scaled by the given motion. Sources: A. Waechter and L. T. Biegler, Mathematical Programming 106 (2006)
(IPOPT); J. T. Betts, *Practical Methods for Optimal Control*, SIAM 2010, chapter 4.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from threading import current_thread, main_thread
from typing import Any

import casadi
import numpy as np
from scipy.interpolate import CubicSpline

from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.reference_design.control_limits import Area, ReferenceLimits, Robot
from flexfmu.model.reference_design.joint_spline import JointSpline, fitted
from flexfmu.model.reference_design.motion_programme import Aim, MotionProgramme
from flexfmu.model.reference_design.transcription import Grid, Transcription, transcribed
from flexfmu.trajectories.jets import RealArray

COARSE, FINE = Grid(intervals=30, stages=3), Grid()
"""Grids that find and that correct a motion: 10 and 0.1 µm of residual vibration by their errors on the shipped robot."""

CHECK = Grid(intervals=56)
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
        iterations: number of IPOPT's iterations.
    """

    spline: JointSpline
    grid: Grid
    converged: bool
    status: str
    iterations: int


@one_blas_thread()
def optimal_motions(
    robots: Sequence[Robot],
    limits: ReferenceLimits,
    area: Area,
    start: JointSpline,
    aim: Aim = "time",
    duration: float | None = None,
    grids: tuple[Grid, Grid] = (COARSE, FINE),
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
        checked = [_checked(robot, area, found.spline) for robot in robots]
        used, depth = limits.used(found.spline), max(each.depth for each in checked)
        shares = [each.torque / robot.torque for each, robot in zip(checked, robots, strict=True)]
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


def _transcriptions(robots: Sequence[Robot], spline: JointSpline, grid: Grid) -> list[Transcription]:
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
        int(stats["iter_count"]),
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


@dataclass(frozen=True, eq=False)
class _Checked:
    """Largest torques (2,) [N m], and depth of the end effector in a region [m]."""

    torque: RealArray
    depth: float


def _checked(robot: Robot, area: Area, spline: JointSpline) -> _Checked:
    """The extremes of a motion between the points of a grid."""
    # the motion on a fine grid
    grid = replace(CHECK, splines=spline.intervals, degree=spline.degree)
    equations = transcribed(robot.scene, spline, grid)
    joints = equations.joints(spline)
    outputs = equations.values(equations.arguments(joints, equations.settled(joints)))[-4:]
    # splines through its outputs
    dense = CubicSpline(grid.points, outputs, axis=1)(np.linspace(grid.points[0], 1.0, DENSE))
    depths = [-each(dense[:2].T).min() for each in area.distances]
    return _Checked(abs(dense[2:]).max(axis=1), max(depths, default=0.0))

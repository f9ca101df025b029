"""Small corrections of joint references, so that they serve all robots of a band: other payloads, stiffness or damping.

The corrections are quintic splines with wide knots, so small that the elastic motion depends linearly on them. Exact
sensitivities of all variants (`ElasticResponse`) make a linear programme: least vibration after the motion, with every end
effector near the path and every torque within its limit; then least distance from the path with little more vibration. It is solved about
references that are corrected by least squares, which takes back what isn't linear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexfmu.model.reference_design.elastic_response import ElasticResponse, Response, free_modes, free_motion
from flexfmu.model.reference_design.inverse_dynamics import LEAD
from flexfmu.model.reference_design.joint_spline import REST, JointSpline, basis, knot_means, reference_derivatives
from flexfmu.model.reference_design.quadratic_programme import solve_quadratic
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import Trajectory

MODES, PERIODS = 2, 0.5
"""Modes that the corrections must reach, and distance of their knots in periods of the highest of these: one for each joint."""

LEAST_SPACING = 0.004
"""Smallest distance of the corrections' knots [s]."""

DIRECTIONS = 8
"""Directions in which a distance in the plane is bounded; it is at most 1/cos(π/8) = 1.08 times the bound."""

VIBRATION_TIME, VIBRATION_STEP = 0.1, 2e-3
"""Time [s] after the motion over which the vibration is bounded, and its resolution."""

ON_PATH = 6
"""Variants whose distance from the path is bounded: it varies little and evenly between them."""

NEAR = 0.5
"""Torques below this fraction of their limit don't count."""

VIOLATION = 5e-3
"""Relative violation of a row that is accepted."""

LARGEST = 20.0
"""Largest step in a variable, in units in which it moves a row by its bound."""

CURVED = 1e-6
"""Curvature of the programmes, for changes in the same units: among equal solutions they have the smallest."""

RIDGE = 1e-9
"""Regularisation of the least squares."""

GROWTH = 1.2
"""By how much the largest distance from the path may grow where it is above its bound before the correction."""

SLACK = 1.5
"""By how much the vibration may grow over the least one where that brings the end effector nearer to the path."""


@dataclass(frozen=True)
class Tolerances:
    """What corrected references have to keep.

    Attributes:
        residual: vibration [m] after the motion below which nearness to the path comes first.
        off_path: largest distance [m] of any variant's end effector from where it should be. Where one errs by more before the
            correction, `GROWTH` of that.
        torque: largest magnitudes of the torques, for each variant and motor (P, 2) [N m]; None for no limit.
        jerk: largest jerk of the joints [rad/s³]; None for no limit.
    """

    residual: float = 2e-7
    off_path: float = 9e-5
    torque: RealArray | None = None
    jerk: float | None = None


def corrected(
    scene: Scene,
    variants: Sequence[Mapping[str, float]],
    motors: JointSpline,
    motion: Trajectory,
    tolerances: Tolerances,
) -> JointSpline:
    """Correct references such that they serve all variants of a robot.

    Args:
        scene: the robot.
        variants: values of FMU parameters of each variant, by name; at least 16 over a band of ±30 % payload, since fewer are
            overfitted.
        motors: references of the motors for the nominal robot.
        motion: where its end effector should be, x and y [m]; it starts `LEAD` after the motors.
        tolerances: what to keep.

    Raises:
        TrajectoryError: no correction keeps all variants near the path within the limits.
        EquilibriumError: a variant's elastic motion has no solution.
    """
    problem = _Problem(scene, variants, motors, motion, tolerances)
    vibration, path, *others = problem.rows(motors)
    if all(bool((each.value <= each.bound).all()) for each in (vibration, path, *others)):
        return motors
    # least squares come so near that the programmes about them are final
    motors = problem.moved(motors, _least_squares([vibration, path]))
    vibration, path, *others = problem.rows(motors)
    least = _solved(vibration, [path, *others])
    if least is None:
        raise TrajectoryError(
            f"no correction of the references keeps all variants within {1e3 * tolerances.off_path:.3g} mm of the path and the "
            "torques within their limits: allow more, give the motion more time, or narrow the band"
        )
    # nearest to the path with little more vibration
    change, residual = least
    nearest = _solved(path, [replace(vibration, bound=max(SLACK * residual, tolerances.residual)), *others])
    return problem.moved(motors, change if nearest is None else nearest[0])


class _Problem:
    """The linear programmes of one correction; arguments as for `corrected`."""

    def __init__(
        self,
        scene: Scene,
        variants: Sequence[Mapping[str, float]],
        motors: JointSpline,
        motion: Trajectory,
        tolerances: Tolerances,
    ) -> None:
        self._tolerances = tolerances
        self._elastic = ElasticResponse(scene, variants, motors.coefficients[0], motors.intervals)
        rest = self._elastic.model.rest(motors.coefficients[-1])
        # a quintic spline makes no motion that is faster than half a period a knot
        highest = float(free_modes(rest).frequencies[:, :MODES].max(initial=1.0))
        self._basis = _correction_basis(motors, max(PERIODS * 2.0 * np.pi / highest, LEAST_SPACING))
        fractions = self._elastic.fractions
        self._targets = motion.evaluate(fractions * motors.duration - LEAD, 0)[0]
        count = round(VIBRATION_TIME / VIBRATION_STEP) + 1
        found = free_motion(rest, 0.0, VIBRATION_STEP, count)
        self._free_vibration, self._at_end = found.reshape(*found.shape[:3], -1), rest.elastic
        # derivatives about the uncorrected references: the corrections are so small that they stay the same
        self._by = self._response(motors, reference_derivatives(motors, self._basis, fractions))
        largest = float(np.hypot(*np.moveaxis(self._path_errors(self._by), -1, 0)).max())
        if largest > tolerances.off_path:
            self._tolerances = replace(tolerances, off_path=GROWTH * largest)
        self._vibration_by = np.einsum(
            "ptix,pxm->ptim", self._free_vibration, self._by.end_by.reshape(len(variants), -1, 2 * self._basis.shape[1])
        )

    def moved(self, motors: JointSpline, change: RealArray) -> JointSpline:
        """References with a change (m,) of the corrections."""
        return replace(motors, coefficients=motors.coefficients + self._basis @ change.reshape(2, -1).T)

    def rows(self, motors: JointSpline) -> list[_Rows]:
        """Rows value + by change <= bound of the vibration, of the path, and of torques and jerks."""
        response, limits = self._response(motors), self._tolerances
        # displacements (P, times, 2) [m] from rest after the motion
        state = response.end.copy()
        state[:, 0] -= self._at_end
        vibration = np.einsum("ptix,px->pti", self._free_vibration, state.reshape(len(state), -1))
        some = np.unique(np.linspace(0, len(state) - 1, ON_PATH).round().astype(int))
        path = self._path_errors(response)[some, 5::6], self._by.position_by[some, 5::6]
        found = [
            _Rows(*_in_directions(vibration, self._vibration_by), limits.residual),
            _Rows(*_in_directions(*path), limits.off_path),
        ]
        if limits.torque is not None:
            most = limits.torque[:, np.newaxis]
            value, by = response.torque / most, self._by.torque_by / most[..., np.newaxis]
            near, sign = np.abs(value) > NEAR, np.sign(value)
            found.append(_Rows(np.abs(value[near]), sign[near][:, np.newaxis] * by[near], 1.0))
        if limits.jerk is not None:
            fractions = np.linspace(0.0, 1.0, 4 * motors.intervals + 1)
            matrix = basis(motors.degree, motors.intervals, fractions, 3) / motors.duration**3 / limits.jerk
            jerk, by_both = (matrix @ motors.coefficients).T.ravel(), np.kron(np.eye(2), matrix @ self._basis)
            found += [_Rows(sign * jerk, np.asarray(sign * by_both, dtype=float), 1.0) for sign in (1.0, -1.0)]
        return found

    def _response(self, motors: JointSpline, by: RealArray | None = None) -> Response:
        references = np.hstack(list(motors.evaluate(self._elastic.fractions)))
        return self._elastic.respond(references, motors.duration, by)

    def _path_errors(self, response: Response) -> RealArray:
        """Displacements (P, N, 2) [m] of all variants from where they should be."""
        return np.asarray(response.position - self._targets)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows ``value`` (r,) + ``by`` (r, m) change <= ``bound``."""

    value: RealArray
    by: RealArray
    bound: float


def _least_squares(parts: Sequence[_Rows]) -> RealArray:
    """The change that makes rows least in the mean of squares, each relative to its bound."""
    weights = [1.0 / (rows.bound * np.sqrt(len(rows.value))) for rows in parts]
    matrix = np.concatenate([weight * rows.by for weight, rows in zip(weights, parts, strict=True)])
    values = np.concatenate([weight * rows.value for weight, rows in zip(weights, parts, strict=True)])
    normal = matrix.T @ matrix
    scale = np.sqrt(np.diag(normal))
    normal = normal / scale / scale[:, np.newaxis] + RIDGE * np.eye(len(scale))
    return np.asarray(-np.linalg.solve(normal, matrix.T @ values / scale) / scale)


def _solved(least: _Rows, kept: Sequence[_Rows]) -> tuple[RealArray, float] | None:
    """The change that makes the largest of some rows least while others keep their bounds, and what it reaches; None if none can.

    Args:
        least: rows whose largest value is minimised; their bound is a scale.
        kept: rows with bounds.
    """
    # [rows, -1] [change, largest] <= upper, all relative to their bounds
    every, goals = [least, *kept], len(least.value)
    score = np.concatenate([rows.value / rows.bound for rows in every])
    matrix = np.concatenate([np.pad(rows.by / rows.bound, ((0, 0), (0, 1))) for rows in every])
    matrix[:goals, -1] = -1.0
    upper = np.concatenate([-score[:goals], 1.0 - score[goals:]])
    units = np.append(np.abs(matrix[:, :-1]).max(axis=0), 1.0)
    matrix /= units
    count = len(units) - 1
    solution, _ = solve_quadratic(
        np.diag(np.append(np.full(count, CURVED), 0.0)), np.append(np.zeros(count), 1.0), matrix, upper,
        np.append(np.full(count, -LARGEST), 0.0), np.append(np.full(count, LARGEST), np.inf),
    )  # fmt: skip
    if (matrix @ solution - upper).max() > VIOLATION:
        return None
    return solution[:-1] / units[:-1], float(solution[-1]) * least.bound


def _in_directions(value: RealArray, by: RealArray) -> tuple[RealArray, RealArray]:
    """Values of vectors (..., 2) and their derivatives (..., 2, m) in all directions, (8 r,) and (8 r, m)."""
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return (value.reshape(-1, 2) @ ways.T).ravel(), (ways @ by.reshape(-1, *by.shape[-2:])).reshape(-1, by.shape[-1])


def _correction_basis(motors: JointSpline, spacing: float) -> RealArray:
    """Coefficients of the references, a column for each free one of the corrections: splines with wide knots (interpolated)."""
    wide = max(round(motors.duration / spacing), 2 * REST)
    degree, intervals = motors.degree, motors.intervals
    means = knot_means(degree, intervals)
    moves = np.linalg.solve(basis(degree, intervals, means), basis(degree, wide, means)[:, REST:-REST])
    moves[:REST], moves[-REST:] = 0.0, 0.0
    return np.asarray(moves)

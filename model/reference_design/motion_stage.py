"""Programmes that improve a motion within limits: the steps of sequential convex programming.

The elastic motion is eliminated: `FleetResponse` gives torques, end effector and end state of all variants with exact
derivatives. A quadratic programme linearises the limits and finds the step that reduces the duration most, less a penalty on
changes of the accelerations that is adapted like a trust region. At the fastest motion about as many limits are active as there are
variables, so that the programmes converge without second derivatives. Limits that can't be met yet are relaxed at a price (l1
merit function), and further programmes with the limits' values at the new motion correct their curvature (second-order
correction).

All limits are g(x) <= slack of their group, with g relative to the limit, and x = [free coefficients of joint 1, of joint 2, T].
What remains of the vibration is bounded mode by mode: the sum over the modes of modal amplitude at the end of the motion times
displacement of the end effector by the mode. It bounds the free vibration after the motion. The amplitude of a mode, the length of
a vector [place, rate], is bounded by half planes in `DIRECTIONS`.

Sources: J. Nocedal and S. Wright, *Numerical Optimization*, Springer 2006, sections 15.6 and 18.5; R. Fletcher and E. Sainz de la
Maza, Nonlinear programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43 (1989).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from flexfmu.model.reference_design.elastic_response import FleetResponse, Response, joined
from flexfmu.model.reference_design.joint_spline import REST, JointSpline, derivative_matrix
from flexfmu.model.reference_design.quadratic_programme import solve_quadratic
from flexfmu.model.reference_design.variants import Rest, VariantModel, free_modes
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.trajectories.jets import RealArray

Distances = Callable[[RealArray], tuple[RealArray, RealArray]]
"""Points (N, 2) [m] → distances (K, N) [m], negative where the end effector must not be, and their gradients (K, N, 2)."""

GROUPS = ("torque", "speed", "acceleration", "jerk", "clearance", "residual")
CLEARANCE, RESIDUAL = 4, 5

DEPTH = 1e-3
"""Depth [m] that counts as much as a torque twice as large as allowed."""

RESIDUAL_SCALE = 0.02
"""A residual vibration twice as large as allowed counts as much as a torque 2 % too large: it ends small anyway."""

DIRECTIONS = np.arange(8) * np.pi / 4
"""Normals [rad] of the half planes that bound the amplitude of a mode; with 8 of them to 8 %."""

WORST = 3
"""Number of variants whose torques and distances count at an instant: those of variants with similar payloads are similar."""

SLOW = 6.0
"""Modes up to this multiple of a variant's lowest frequency count; smooth references don't excite faster ones."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of a motion for P variants.

    Attributes:
        torque: largest magnitude of both motor torques (P, 2) [N m].
        speed, acceleration, jerk: largest magnitudes of the joint references [rad/s, rad/s², rad/s³].
        residual: largest displacement of the end effector by vibration after the motion [m].
        distances: to what the end effector must keep clear of.
    """

    torque: RealArray
    speed: float
    acceleration: float
    jerk: float
    residual: float
    distances: Distances


@dataclass(frozen=True, eq=False)
class Inequalities:
    """Inequalities at a motion: values g (R,), indices of their groups (R,), derivatives (R, m), and which can decide (R,)."""

    values: RealArray
    groups: NDArray[np.intp]
    jacobian: RealArray
    deciding: NDArray[np.bool_]


class LimitRows:
    """The limits of motions of one size, but for the residual vibration, row by row: references, torques, clearance.

    Args:
        limits: the limits.
        degree, intervals: of the splines.
    """

    def __init__(self, limits: MotionLimits, degree: int, intervals: int) -> None:
        self.limits = limits
        # the first and last coefficients of derivatives are zero
        self._matrices = [derivative_matrix(degree, intervals, k)[REST - k : k - REST] for k in (1, 2, 3)]
        self._largest = (limits.speed, limits.acceleration, limits.jerk)
        self.free = intervals + degree - 2 * REST

    def values(self, motion: JointSpline, response: Response) -> tuple[RealArray, NDArray[np.intp]]:
        """g (R,) and the groups (R,)."""
        found = [np.abs(each).ravel() - 1.0 for each in self._references(motion)]
        found.append((np.abs(response.torque) / self.limits.torque[:, np.newaxis] - 1.0).ravel())
        found.append(-self.limits.distances(response.position.reshape(-1, 2))[0].ravel() / DEPTH)
        groups = [np.full(each.size, group) for each, group in zip(found, (1, 2, 3, 0, 4), strict=True)]
        return np.concatenate(found), np.concatenate(groups)

    def rows(self, motion: JointSpline, response: Response) -> Inequalities:
        """The inequalities with derivatives."""
        values, groups = self.values(motion, response)
        m = 2 * self.free + 1
        found = []
        for k, (matrix, each, largest) in enumerate(
            zip(self._matrices, self._references(motion), self._largest, strict=True), 1
        ):
            block = np.zeros((len(matrix), 2, m))
            for joint in range(2):
                columns = slice(joint * self.free, (joint + 1) * self.free)
                block[:, joint, columns] = matrix[:, REST:-REST] / (largest * motion.duration**k)
            block[..., -1] = -k * each / motion.duration
            found.append((np.sign(each)[..., np.newaxis] * block).reshape(-1, m))
        signed = np.sign(response.torque) / self.limits.torque[:, np.newaxis]
        found.append((signed[..., np.newaxis] * response.torque_by).reshape(-1, m))
        gradient = self.limits.distances(response.position.reshape(-1, 2))[1]
        gradient = np.asarray(gradient).reshape(-1, *response.position.shape)
        found.append((-np.einsum("kpnj,pnjm->kpnm", gradient, response.position_by) / DEPTH).reshape(-1, m))
        return Inequalities(values, groups, np.concatenate(found), self._deciding(values, response))

    def _deciding(self, values: RealArray, response: Response) -> NDArray[np.bool_]:
        """Which rows can decide (R,): of torques and of distances those of the `WORST` variants at the same instant."""
        count, instants, joints = response.torque.shape
        found, first = np.ones(len(values), dtype=bool), 2 * sum(map(len, self._matrices))
        middle = first + response.torque.size
        parts = [(slice(first, middle), (1, count, instants * joints)), (slice(middle, None), (-1, count, instants))]
        for part, shape in parts if count > WORST else ():
            of_variants = values[part].reshape(shape)
            least = np.partition(of_variants, -WORST, axis=1)[:, -WORST, np.newaxis]
            found[part] = (of_variants >= least).ravel()
        return found

    def _references(self, motion: JointSpline) -> list[RealArray]:
        """Coefficients of speed, acceleration and jerk, each relative to its limit (n_k, 2)."""
        return [
            matrix @ motion.coefficients / (motion.duration**k * largest)
            for k, (matrix, largest) in enumerate(zip(self._matrices, self._largest, strict=True), 1)
        ]


class ResidualVibration:
    """Modal amplitudes of the vibration that remains at the end, in displacements of the end effector.

    Args:
        models: the variants of each scene.
        end: joint angles after the motion (2,) [rad].
    """

    def __init__(self, models: Sequence[VariantModel], end: RealArray) -> None:
        rests = [model.rest(end) for model in models]
        # from elastic coordinates and their rates at the end: (P, 2, k, n)
        self.matrices = joined([_to_amplitudes(rest) for rest in rests])
        self._rest = joined([rest.elastic for rest in rests])
        self.error = np.zeros((len(self._rest), 2, self._rest.shape[1]))

    def amplitudes(self, end: RealArray) -> RealArray:
        """Modal places and rates (P, 2, k) [m] for states at the end (P, 2, n), the grid's error added."""
        away = end + self.error
        away[:, 0] -= self._rest
        return np.asarray((self.matrices @ away[..., np.newaxis])[..., 0])

    def largest(self, end: RealArray) -> RealArray:
        """Bounds (P,) of the displacement of the end effector after the motion [m]."""
        return np.asarray(np.linalg.norm(self.amplitudes(end), axis=1).sum(axis=-1))


def _to_amplitudes(rest: Rest) -> RealArray:
    """Matrices (P, 2, k, n) from elastic coordinates and their rates to displacements of the end effector by the k slowest modes."""
    modes = free_modes(rest)
    count = int((modes.frequencies < SLOW * modes.frequencies[:, :1]).any(axis=0).sum())
    size = np.linalg.norm(modes.displacements, axis=1)[:, :count, np.newaxis]
    coordinates = modes.coordinates[:, :count] * size
    return np.stack([coordinates, coordinates / modes.frequencies[:, :count, np.newaxis]], axis=1)


PRICES = 2.0, 500.0
"""Price of a slack, in durations of the start, at first and at most; it grows while limits that can be met aren't."""

REACH = 0.1
"""Largest change of a coefficient in one step, relative to the swing of the joints, and of the duration."""

NEAR, FAR = 0.15, 3.0
"""Torques and references that stay so far below their limit, relative to it, don't enter a programme, nor distances above 3 mm."""

MET = 1e-4
"""Violation up to which a limit counts as met."""

CURVED = 1e-4
"""Least curvature of the merit, in durations for a change of all coefficients by the swing: programmes have one solution."""

PENALTY = 0.3, 1e4
"""Penalty on changes of the accelerations at first, and at most."""

CORRECTIONS = 2
"""Largest number of corrections of a step."""

ENOUGH = 1e-3
"""Predicted fall of the merit, in durations of the start, below which a motion is the best."""


@dataclass(frozen=True, eq=False)
class State:
    motion: JointSpline
    response: Response
    violations: RealArray
    merit: float


@dataclass(frozen=True, eq=False)
class Linear:
    """The limits, linearised at a motion: rows, modal amplitudes (P, 2, k) and their derivatives (P, 2, k, m)."""

    rows: Inequalities
    amplitudes: RealArray
    amplitudes_by: RealArray


class Stage:
    """The limits of some variants, and their programmes.

    Args:
        elastic: the variants' response.
        limits: the limits of these variants.
        start: a motion with the ends and the size of all.
        unit: duration that counts as 1 in the merit [s].
    """

    def __init__(self, elastic: FleetResponse, limits: MotionLimits, start: JointSpline, unit: float) -> None:
        self.elastic, self.limits, self.unit = elastic, limits, unit
        self.price, self.penalty = PRICES[0], PENALTY[0]
        self._rows = LimitRows(limits, start.degree, start.intervals)
        self.vibration = ResidualVibration([part.model for part in elastic.parts], start.coefficients[-1])
        m = 2 * self._rows.free + 1
        swing = float(np.ptp(start.coefficients, axis=0).max())
        self._scale = np.concatenate([np.full(m - 1, swing), [unit]])
        # changes of acceleration, relative to the largest one, and of the duration
        curve = derivative_matrix(start.degree, start.intervals, 2)
        by_free = curve[:, REST:-REST]
        self._metric = np.zeros((m, m))
        self._metric[:-1, :-1] = np.kron(np.eye(2), by_free.T @ by_free)
        self._metric[:-1, :-1] /= np.abs(curve @ start.coefficients).max() ** 2
        self._metric[-1, -1] = 0.1 * len(curve) / unit**2

    def state(self, motion: JointSpline, *, derivatives: bool = True) -> State:
        """Evaluate a motion."""
        response = self.elastic.of_spline(motion, derivatives=derivatives)
        violations = self.violations(motion, response, self.vibration.largest(response.end))
        return State(motion, response, violations, self.merit(motion, violations))

    def violations(self, motion: JointSpline, response: Response, residuals: RealArray) -> RealArray:
        """The largest violation of each group."""
        values, groups = self._rows.values(motion, response)
        found = np.zeros(len(GROUPS))
        np.maximum.at(found, groups, values)
        found[RESIDUAL] = max(0.0, float(residuals.max(initial=0.0)) / self.limits.residual - 1.0) * RESIDUAL_SCALE
        return found

    def merit(self, motion: JointSpline, violations: RealArray) -> float:
        """The duration and the price of what isn't met, in durations of the start."""
        return motion.duration / self.unit + self.price * float(violations.sum())

    def linear(self, state: State) -> Linear:
        """Linearise the limits at a motion."""
        by = self.vibration.matrices @ state.response.end_by
        return Linear(self._rows.rows(state.motion, state.response), self.vibration.amplitudes(state.response.end), by)

    def corrected(self, linear: Linear, step: RealArray, state: State) -> Linear:
        """The linearised limits with their values after a step."""
        values, groups = self._rows.values(state.motion, state.response)
        amplitudes = self.vibration.amplitudes(state.response.end) - linear.amplitudes_by @ step
        shifted = Inequalities(values - linear.rows.jacobian @ step, groups, linear.rows.jacobian, linear.rows.deciding)
        return Linear(shifted, amplitudes, linear.amplitudes_by)

    def step(self, linear: Linear, penalty: float) -> tuple[RealArray, float]:
        """The best step (m,) and the merit after it less T / unit, as the linearised limits predict."""
        rows, (variants, _, modes, m) = linear.rows, linear.amplitudes_by.shape
        near = np.flatnonzero(rows.deciding & (rows.values > np.where(rows.groups == CLEARANCE, -FAR, -NEAR)))
        slacks, planes = len(GROUPS), len(DIRECTIONS) * variants * modes
        size = m + slacks + variants * modes
        # limits; half planes of each mode's amplitude; the sum of amplitudes for each variant
        matrix = np.zeros((len(near) + planes + variants, size))
        matrix[: len(near), :m] = rows.jacobian[near]
        matrix[np.arange(len(near)), m + rows.groups[near]] = -1.0
        scale, normals = RESIDUAL_SCALE / self.limits.residual, np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
        block = matrix[len(near) : len(near) + planes]
        block[:, :m] = scale * np.einsum("id,pikm->dpkm", normals, linear.amplitudes_by).reshape(planes, m)
        block[:, m + slacks :] = np.tile(np.eye(variants * modes), (len(DIRECTIONS), 1)) * -np.cos(DIRECTIONS[1] / 2)
        matrix[len(near) + planes :, m + slacks :] = np.kron(np.eye(variants), np.ones(modes))
        matrix[len(near) + planes :, m + RESIDUAL] = -1.0
        reached = scale * np.einsum("id,pik->dpk", normals, linear.amplitudes).ravel()
        right = np.concatenate([-rows.values[near], -reached, np.full(variants, RESIDUAL_SCALE)])
        # in units of the scale
        unit = np.concatenate([self._scale, np.ones(size - m)])
        quadratic, cost = np.zeros((size, size)), np.zeros(size)
        quadratic[:m, :m] = penalty * self._metric + np.diag(CURVED / self._scale**2)
        cost[m - 1], cost[m : m + slacks] = 1.0 / self.unit, self.price
        lower, upper = np.zeros(size), np.full(size, np.inf)
        lower[:m], upper[:m] = -REACH, REACH
        x = unit * solve_quadratic(
            quadratic * unit[:, np.newaxis] * unit, cost * unit, matrix * unit, right, lower, upper
        )
        return x[:m], float(cost @ x)

    def improvements(self, start: JointSpline, iterations: int, penalty: float = PENALTY[0]) -> Iterator[State]:
        """Better and better motions, from the start on.

        Args:
            start: the first motion.
            iterations: largest number of programmes.
            penalty: first penalty on changes of the accelerations.
        """
        state = self.state(start)
        linear = self.linear(state)
        yield state
        for _ in range(iterations):
            step, predicted = self.step(linear, penalty)
            fall = state.merit - state.motion.duration / self.unit - predicted
            if fall < max(ENOUGH, 0.02 * self.price * float(state.violations.max())):
                # the best motion, or one that would rather pay than meet its limits
                if float(state.violations.max()) < MET or self.price >= PRICES[1]:
                    return
                self.price *= 4.0
                state = replace(state, merit=self.merit(state.motion, state.violations))
                continue
            found = self._after_step(state, linear, step, penalty, fall)
            ratio = (state.merit - found.merit) / fall
            if ratio > 0.1:
                state = self.state(found.motion)
                linear = self.linear(state)
                yield state
            penalty *= 4.0 if ratio < 0.1 else 2.0 if ratio < 0.4 else 0.4 if ratio > 0.8 else 1.0
            self.penalty = penalty
            if penalty > PENALTY[1]:
                return

    def _after_step(self, state: State, linear: Linear, step: RealArray, penalty: float, fall: float) -> State:
        """The motion after a step, or after its second-order correction if that is better; the old one where there is none."""
        try:
            found = self.state(_moved(state.motion, step), derivatives=False)
            last = found
            for _ in range(CORRECTIONS):
                if (state.merit - found.merit) / fall > 0.9:
                    break
                step = self.step(self.corrected(linear, step, last), penalty)[0]
                last = self.state(_moved(state.motion, step), derivatives=False)
                found = min(found, last, key=lambda each: each.merit)
        except EquilibriumError:
            return state
        return found


def _moved(motion: JointSpline, step: RealArray) -> JointSpline:
    """The motion after a step of the variables."""
    coefficients = motion.coefficients.copy()
    coefficients[REST:-REST] += step[:-1].reshape(2, -1).T
    return JointSpline(coefficients, motion.duration + float(step[-1]), motion.degree)

"""Programmes that improve a motion within limits: the steps of sequential convex programming.

The elastic motion is eliminated: `FleetResponse` gives torques, end effector and end state of all variants with exact
derivatives. A quadratic programme linearises the limits and finds the step that reduces the duration most, less a penalty on
changes of the accelerations that is adapted like a trust region. At the fastest motion about as many limits are active as there are
variables, so that the programmes converge without second derivatives. Limits that can't be met yet are relaxed at a price (l1
merit function), and further programmes with the limits' values at the new motion correct their curvature (second-order
correction).

Sources: J. Nocedal and S. Wright, *Numerical Optimization*, Springer 2006, sections 15.6 and 18.5; R. Fletcher and E. Sainz de la
Maza, Nonlinear programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43 (1989).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from flexfmu.model.reference_design.elastic_response import FleetResponse, Response
from flexfmu.model.reference_design.joint_spline import REST, JointSpline, derivative_matrix
from flexfmu.model.reference_design.motion_limits import (
    CLEARANCE,
    DIRECTIONS,
    GROUPS,
    RESIDUAL,
    RESIDUAL_SCALE,
    LimitRows,
    MotionLimits,
    ResidualVibration,
    Rows,
)
from flexfmu.model.reference_design.quadratic_programme import solve_quadratic
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.trajectories.jets import RealArray

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

    rows: Rows
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
        shifted = Rows(values - linear.rows.jacobian @ step, groups, linear.rows.jacobian, linear.rows.deciding)
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
            found = self._tried(state, linear, step, penalty, fall)
            ratio = (state.merit - found.merit) / fall
            if ratio > 0.1:
                state = self.state(found.motion)
                linear = self.linear(state)
                yield state
            penalty *= 4.0 if ratio < 0.1 else 2.0 if ratio < 0.4 else 0.4 if ratio > 0.8 else 1.0
            self.penalty = penalty
            if penalty > PENALTY[1]:
                return

    def _tried(self, state: State, linear: Linear, step: RealArray, penalty: float, fall: float) -> State:
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

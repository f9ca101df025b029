"""Optimal joint references within limits that hold for several variants of a robot, by sequential convex programming.

The first stage has few variants and a loose bound on the residual vibration; the bound then falls, with more variants. In the end
all variants are evaluated on a finer grid: its end state corrects that of the coarse one, the worst variants join the others, and
what still lies between them tightens the limits.

The elastic motion is eliminated: `FleetResponse` gives torques, end effector and end state of all variants with exact
derivatives. A quadratic programme linearises the limits and finds the step that reduces the duration, or the motors' effort in a given
duration, most, less a penalty on changes of the accelerations that is adapted like a trust region. At the fastest motion about as many
limits are active as there are variables, so that the programmes converge without second derivatives; the effort is a sum of convex
functions of torques or powers, whose curvature they have (Gauss-Newton). Limits that can't be met yet are relaxed at a price (l1
merit function), and further programmes with the limits' values at the new motion correct their curvature (second-order
correction).

All limits are g(x) <= slack of their group, with g relative to the limit, and x = [free coefficients of joint 1, of joint 2, T].
What remains of the vibration is bounded mode by mode: the sum over the modes of modal amplitude at the end of the motion times
displacement of the end effector by the mode. It bounds the free vibration after the motion. The amplitude of a mode, the length of
a vector [place, rate], is bounded by half planes in `DIRECTIONS`.

Power, RMS torque, energy and the power of the supply follow from torques and speeds (`MotorLoads`), over the motion and the pause after it.

Sources: J. Nocedal and S. Wright, *Numerical Optimization*, Springer 2006, sections 15.6 and 18.5; R. Fletcher and E. Sainz de la
Maza, Nonlinear programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43 (1989).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from flexfmu.model.reference_design.elastic_response import (
    METHOD,
    FleetResponse,
    Response,
    Rest,
    RobotVariant,
    VariantModel,
    free_modes,
    joined,
    spline_derivatives,
)
from flexfmu.model.reference_design.joint_spline import REST, JointSpline, derivative_matrix
from flexfmu.model.reference_design.quadratic_programme import solve_quadratic
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.trajectories.jets import RealArray

Distances = Callable[[RealArray], tuple[RealArray, RealArray]]
"""Points (N, 2) [m] → distances (K, N) [m], negative where the end effector must not be, and their gradients (K, N, 2)."""

GROUPS = (
    "torque", "speed", "acceleration", "jerk", "clearance", "residual", "power", "rms_torque", "energy", "supply_power",
    "regenerated_power",
)  # fmt: skip
CLEARANCE, RESIDUAL = 4, 5

DEPTH = 1e-3
"""Depth [m] that counts as much as a torque twice as large as allowed."""

RESIDUAL_SCALE = 0.02
"""A residual vibration twice as large as allowed counts as much as a torque 2 % too large: it ends small anyway."""

DIRECTIONS = np.arange(8) * np.pi / 4
"""Normals [rad] of the half planes that bound the amplitude of a mode; with 8 of them to 8 %."""

WORST = 3
"""Number of variants whose torques and distances count at an instant: those of variants with similar payloads are similar."""

OF_MOTION, TINY = ("rms_torque", "energy"), 1e-9
"""Loads of the whole motion, not of an instant, and an RMS torque [N m] that is none."""

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
        loads: largest values of further figures of `MotorLoads`, by name.
        pause: time at rest after the motion [s], which RMS torques contain.
    """

    torque: RealArray
    speed: float
    acceleration: float
    jerk: float
    residual: float
    distances: Distances
    loads: Mapping[str, RealArray] = field(default_factory=dict)
    pause: float = 0.0

    def tightened(self, factors: Mapping[str, float]) -> MotionLimits:
        """The limits, each divided by a factor; 1 where there is none."""
        names = ("torque", "speed", "acceleration", "jerk", "residual")
        return replace(
            self,
            **{name: getattr(self, name) / factors.get(name, 1.0) for name in names},
            loads={name: limit / factors.get(name, 1.0) for name, limit in self.loads.items()},
        )

    def of_variants(self, chosen: NDArray[np.intp]) -> MotionLimits:
        """The limits of some variants."""
        loads = {name: limit[chosen] for name, limit in self.loads.items()}
        return replace(self, torque=self.torque[chosen], loads=loads)


class MotorLoads:
    """What motors and their supply have to do for a motion of P variants, at N instants or over motion and pause, with derivatives.

    Its figures are by name: ``torque`` (P, N, 2) [N m] and ``power`` (P, N, 2) [W] of both motors, positive into the robot;
    ``rms_torque`` (P, 2) [N m]; ``energy`` (P,) [J] that they give, without what they take back; ``supply_power`` and ``regenerated_power``
    (P, N) [W] of both together, zero where the other one flows.

    Args:
        fractions: instants (N,), the stages of equal steps, as fractions of the duration.
        holding: torques at rest after the motion (P, 2) [N m].
        pause: time at rest after the motion [s].
    """

    def __init__(self, fractions: RealArray, holding: RealArray | float = 0.0, pause: float = 0.0) -> None:
        steps = len(fractions) // 3
        self._fractions, self._holding, self._pause = fractions, holding, pause
        self.weights = np.tile(METHOD.matrix[-1], steps) / steps

    def values(self, names: Iterable[str], motion: JointSpline, response: Response) -> dict[str, RealArray]:
        """The figures of these names."""
        return self.of_speeds(names, motion.evaluate(self._fractions, 1)[1], motion.duration, response.torque)

    def of_speeds(
        self, names: Iterable[str], speed: RealArray, duration: float, torque: RealArray
    ) -> dict[str, RealArray]:
        """The figures for joint speeds (N, 2) [rad/s], a duration [s] and torques (P, N, 2) [N m]."""
        power = torque * speed
        square = np.einsum("n,pnj->pj", duration * self.weights, torque**2) + self._pause * np.square(self._holding)
        find: dict[str, Callable[[], RealArray]] = {
            "torque": lambda: torque,
            "power": lambda: power,
            "rms_torque": lambda: np.sqrt(square / (duration + self._pause)),
            "energy": lambda: duration * np.einsum("n,pnj->p", self.weights, np.maximum(power, 0.0)),
            "supply_power": lambda: np.maximum(power.sum(axis=2), 0.0),
            "regenerated_power": lambda: np.maximum(-power.sum(axis=2), 0.0),
        }
        return {name: find[name]() for name in names}

    def speed_derivatives(self, motion: JointSpline) -> RealArray:
        """Derivatives of the joint speeds (N, 2, m)."""
        return spline_derivatives(motion, self._fractions)[:, 2:4]

    def derivatives(self, names: Iterable[str], motion: JointSpline, response: Response) -> dict[str, RealArray]:
        """Their derivatives by the m variables, in one more dimension."""
        torque, by, duration = response.torque, response.torque_by, motion.duration
        found = {"torque": by}
        names = [name for name in names if name != "torque"]
        if not names:
            return found
        speed, speed_by = motion.evaluate(self._fractions, 1)[1], self.speed_derivatives(motion)
        power, power_by = torque * speed, by * speed[..., np.newaxis] + torque[..., np.newaxis] * speed_by
        for name in names:
            if name == "power":
                found[name] = power_by
            elif name == "rms_torque":
                # of the mean square; the last variable is the duration
                root = self.of_speeds([name], speed, duration, torque)[name]
                slope = 2.0 * np.einsum("n,pnj,pnjm->pjm", duration * self.weights, torque, by)
                slope[..., -1] += np.einsum("n,pnj->pj", self.weights, torque**2) - root**2
                found[name] = slope / (2.0 * np.maximum(root, TINY) * (duration + self._pause))[..., np.newaxis]
            elif name == "energy":
                found[name] = duration * np.einsum("n,pnj,pnjm->pm", self.weights, (power > 0.0) * 1.0, power_by)
                found[name][:, -1] += np.einsum("n,pnj->p", self.weights, np.maximum(power, 0.0))
            else:
                sign = 1.0 if name == "supply_power" else -1.0
                flows = sign * power.sum(axis=2) > 0.0
                found[name] = (sign * flows)[..., np.newaxis] * power_by.sum(axis=2)
        return found


@dataclass(frozen=True, eq=False)
class Inequalities:
    """Inequalities at a motion: values g (R,), indices of their groups (R,), derivatives (R, m), and which can decide (R,)."""

    values: RealArray
    groups: NDArray[np.intp]
    jacobian: RealArray
    deciding: NDArray[np.bool_]


class LimitRows:
    """The limits of motions of one size, but for the residual vibration, row by row: references, loads of the motors, clearance.

    Args:
        limits: the limits.
        degree, intervals: of the splines.
        motors: the figures of their loads.
    """

    def __init__(self, limits: MotionLimits, degree: int, intervals: int, motors: MotorLoads) -> None:
        self.limits, self._motors = limits, motors
        # the first and last coefficients of derivatives are zero
        self._matrices = [derivative_matrix(degree, intervals, k)[REST - k : k - REST] for k in (1, 2, 3)]
        self._largest = (limits.speed, limits.acceleration, limits.jerk)
        self.free = intervals + degree - 2 * REST
        # of each load relative to its limit, at all instants
        loads = {"torque": limits.torque, **limits.loads}
        self._units = {name: limit[:, np.newaxis] if name not in OF_MOTION else limit for name, limit in loads.items()}

    def values(self, motion: JointSpline, response: Response) -> tuple[RealArray, NDArray[np.intp]]:
        """g (R,) and the groups (R,)."""
        parts = self._parts(motion, response)
        groups = [np.full(each.size, GROUPS.index(name)) for name, each in parts]
        return np.concatenate([each.ravel() for _, each in parts]), np.concatenate(groups)

    def loads(self, motion: JointSpline, response: Response) -> dict[str, RealArray]:
        """Each load relative to its limit, with its sign, by name."""
        found = self._motors.values(self._units, motion, response)
        return {name: each / self._units[name] for name, each in found.items()}

    def rows(self, motion: JointSpline, response: Response) -> Inequalities:
        """The inequalities with derivatives."""
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
        by = self._motors.derivatives(self._units, motion, response)
        for name, each in self.loads(motion, response).items():
            found.append(((np.sign(each) / self._units[name])[..., np.newaxis] * by[name]).reshape(-1, m))
        gradient = self.limits.distances(response.position.reshape(-1, 2))[1]
        gradient = np.asarray(gradient).reshape(-1, *response.position.shape)
        found.append((-np.einsum("kpnj,pnjm->kpnm", gradient, response.position_by) / DEPTH).reshape(-1, m))
        deciding = [_deciding(name, each).ravel() for name, each in self._parts(motion, response)]
        return Inequalities(*self.values(motion, response), np.concatenate(found), np.concatenate(deciding))

    def curvature(self, motion: JointSpline, response: Response, prices: RealArray) -> RealArray:
        """The curvature (m, m) of the loads, each row's by its price (R,), its positive part.

        Torques and speeds count as linear (Gauss-Newton): mean squares of torques, and products of torques and speeds are curved.
        """
        by, speed_by = response.torque_by, self._motors.speed_derivatives(motion)
        squares, products = np.zeros(response.torque.shape), np.zeros(response.torque.shape)
        first, share = 0, motion.duration * self._motors.weights[:, np.newaxis]
        for name, each in self._parts(motion, response):
            price, first = prices[first : first + each.size].reshape(each.shape), first + each.size
            if name in self.limits.loads and price.any():
                price = price / self._units[name]
                if name == "rms_torque":
                    root = (each + 1.0) * self._units[name]
                    squares += (price / (root * (motion.duration + self.limits.pause)))[:, np.newaxis] * share
                    continue
                power = self._motors.values(["power"], motion, response)["power"]
                if name == "power":
                    products += np.sign(power) * price
                elif name == "energy":
                    products += price[:, np.newaxis, np.newaxis] * share * (power > 0.0)
                else:
                    products += ((1.0 if name == "supply_power" else -1.0) * price)[..., np.newaxis]
        found = np.einsum("pnj,pnja,pnjb->ab", squares, by, by, optimize=True)
        p, n, j = np.nonzero(products)
        cross = (products[p, n, j, np.newaxis] * by[p, n, j]).T @ speed_by[n, j]
        values, vectors = np.linalg.eigh(found + cross + cross.T)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)

    def _parts(self, motion: JointSpline, response: Response) -> list[tuple[str, RealArray]]:
        """The group of each part of the rows, and g."""
        found = [(name, np.abs(each) - 1.0) for name, each in zip(GROUPS[1:4], self._references(motion), strict=True)]
        found += [(name, np.abs(each) - 1.0) for name, each in self.loads(motion, response).items()]
        distances = self.limits.distances(response.position.reshape(-1, 2))[0]
        return [*found, ("clearance", -distances.reshape(-1, *response.position.shape[:2]) / DEPTH)]

    def _references(self, motion: JointSpline) -> list[RealArray]:
        """Coefficients of speed, acceleration and jerk, each relative to its limit (n_k, 2)."""
        return [
            matrix @ motion.coefficients / (motion.duration**k * largest)
            for k, (matrix, largest) in enumerate(zip(self._matrices, self._largest, strict=True), 1)
        ]


def _deciding(name: str, values: RealArray) -> NDArray[np.bool_]:
    """Which of a part's rows can decide: at each instant those of the `WORST` variants."""
    axis = 1 if name == "clearance" else 0
    if name in (*GROUPS[1:4], *OF_MOTION) or values.shape[axis] <= WORST:
        return np.ones(values.shape, dtype=bool)
    least = np.partition(values, -WORST, axis=axis).take([-WORST], axis=axis)
    return np.asarray(values >= least)


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
        self.holding = joined([rest.torque for rest in rests])
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
"""Price of a slack, in costs of the start, at first and at most; it grows while limits that can be met aren't."""

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
"""Predicted fall of the merit, relative to the start's cost, below which a motion is the best."""


Aim = Literal["time", "torque", "rms_torque", "energy", "residual"]
"""What is minimised; all but time at a given duration. The aim "residual" is a motion without any at the least RMS torques."""

PEAK = 8
"""Power whose mean stands for a peak."""

ROUNDING = 0.05
"""Power within which the corner at zero is rounded, relative to the largest torque x the largest speed of the start."""


class Effort:
    """What the motors' effort costs: a mean over variants and instants, relative to that of a first motion.

    Torques count by their squares or, for the peak, by a high power; of the energy counts what the motors give, without what they
    take back.

    Args:
        aim: what is minimised.
        start: the first motion.
        response: of the variants to it.
        fractions: instants of responses (N,), the stages of equal steps.
    """

    def __init__(self, aim: Aim, start: JointSpline, response: Response, fractions: RealArray) -> None:
        self._aim, self._motors = aim, MotorLoads(fractions)
        self._name = "power" if aim == "energy" else "torque"
        self._weights = self._motors.weights[:, np.newaxis] / len(response.torque)
        self._largest = np.abs(response.torque).max()
        if aim == "energy":
            self._largest *= np.abs(start.evaluate(fractions, 1)[1]).max()
        self._unit = 1.0
        self._unit = self.value(start, response)

    def value(self, motion: JointSpline, response: Response) -> float:
        """The cost of a motion."""
        return float((self._weights * self._costs(self._figures(motion, response))[0]).sum()) / self._unit

    def derivatives(self, motion: JointSpline, response: Response) -> tuple[RealArray, RealArray]:
        """Gradient (m,) of the cost, and the positive part of its curvature (m, m)."""
        figures = self._figures(motion, response)
        by = self._motors.derivatives([self._name], motion, response)[self._name] / self._largest
        _, slopes, curvatures = (self._weights * each / self._unit for each in self._costs(figures))
        flat = by.reshape(-1, by.shape[-1])
        return np.asarray(slopes.ravel() @ flat), np.asarray((flat.T * curvatures.ravel()) @ flat)

    def _figures(self, motion: JointSpline, response: Response) -> RealArray:
        """Torques, or for the energy powers, (P, N, 2), relative to the largest of the first motion."""
        return np.asarray(self._motors.values([self._name], motion, response)[self._name] / self._largest)

    def _costs(self, y: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """A convex function of figures, with its first and second derivatives."""
        if self._aim == "energy":
            root = np.sqrt(y**2 + ROUNDING**2)
            return 0.5 * (y + root), 0.5 * (1.0 + y / root), 0.5 * ROUNDING**2 / root**3
        power = PEAK if self._aim == "torque" else 2
        return y**power, power * y ** (power - 1), power * (power - 1) * y ** (power - 2)


@dataclass(frozen=True, eq=False)
class State:
    """A motion, and what it costs in units of the start's."""

    motion: JointSpline
    response: Response
    violations: RealArray
    cost: float


@dataclass(frozen=True, eq=False)
class Linear:
    """The limits, linearised at a motion: rows, modal amplitudes (P, 2, k) and their derivatives (P, 2, k, m).

    Attributes:
        slope, curvature: of the cost, (m,) and (m, m).
    """

    rows: Inequalities
    amplitudes: RealArray
    amplitudes_by: RealArray
    slope: RealArray
    curvature: RealArray


class Stage:
    """The limits of some variants, and their programmes.

    Args:
        elastic: the variants' response.
        limits: the limits of these variants.
        start: a motion with the ends and the size of all.
        unit: duration that costs 1 [s].
        aim: what is minimised; the effort of the start costs 1.
    """

    def __init__(
        self, elastic: FleetResponse, limits: MotionLimits, start: JointSpline, unit: float, aim: Aim = "time"
    ) -> None:
        self.elastic, self.limits, self.unit = elastic, limits, unit
        self._effort = None
        if aim != "time":
            self._effort = Effort(aim, start, elastic.of_spline(start, derivatives=False), elastic.fractions)
        self.price, self.penalty = PRICES[0], PENALTY[0]
        self._prices: RealArray | None = None
        self.vibration = ResidualVibration([part.model for part in elastic.parts], start.coefficients[-1])
        motors = MotorLoads(elastic.fractions, self.vibration.holding, limits.pause)
        self.rows = LimitRows(limits, start.degree, start.intervals, motors)
        m = 2 * self.rows.free + 1
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
        cost = motion.duration / self.unit if self._effort is None else self._effort.value(motion, response)
        return State(motion, response, violations, cost)

    def violations(self, motion: JointSpline, response: Response, residuals: RealArray) -> RealArray:
        """The largest violation of each group."""
        values, groups = self.rows.values(motion, response)
        found = np.zeros(len(GROUPS))
        np.maximum.at(found, groups, values)
        found[RESIDUAL] = max(0.0, float(residuals.max(initial=0.0)) / self.limits.residual - 1.0) * RESIDUAL_SCALE
        return found

    def merit(self, state: State) -> float:
        """The cost, and the price of what isn't met."""
        return state.cost + self.price * float(state.violations.sum())

    def linear(self, state: State) -> Linear:
        """Linearise the limits at a motion."""
        motion, response = state.motion, state.response
        by, reached = self.vibration.matrices @ response.end_by, self.vibration.amplitudes(response.end)
        if self._effort is None:
            slope, curvature = np.zeros(len(self._scale)), np.zeros_like(self._metric)
            slope[-1] = 1.0 / self.unit
        else:
            slope, curvature = self._effort.derivatives(motion, response)
        if self._prices is not None:
            curvature = curvature + self.rows.curvature(motion, response, self._prices)
        return Linear(self.rows.rows(motion, response), reached, by, slope, curvature)

    def corrected(self, linear: Linear, step: RealArray, state: State) -> Linear:
        """The linearised limits with their values after a step."""
        values, groups = self.rows.values(state.motion, state.response)
        amplitudes = self.vibration.amplitudes(state.response.end) - linear.amplitudes_by @ step
        shifted = Inequalities(values - linear.rows.jacobian @ step, groups, linear.rows.jacobian, linear.rows.deciding)
        return replace(linear, rows=shifted, amplitudes=amplitudes)

    def step(self, linear: Linear, penalty: float) -> tuple[RealArray, float]:
        """The best step (m,) and the change of the cost, with the price of what isn't met after it, as they predict.

        The multipliers of the rows are kept: they weigh the curvature of the next programme.
        """
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
        quadratic[:m, :m] = penalty * self._metric + np.diag(CURVED / self._scale**2) + linear.curvature
        cost[:m], cost[m : m + slacks] = linear.slope, self.price
        if self._effort is not None:
            # the duration is given
            cost[m - 1], quadratic[m - 1, : m - 1], quadratic[: m - 1, m - 1], matrix[:, m - 1] = 0.0, 0.0, 0.0, 0.0
        lower, upper = np.zeros(size), np.full(size, np.inf)
        lower[:m], upper[:m] = -REACH, REACH
        x, prices = solve_quadratic(
            quadratic * unit[:, np.newaxis] * unit, cost * unit, matrix * unit, right, lower, upper
        )
        x = unit * x
        self._prices = np.zeros(len(rows.values))
        self._prices[near] = prices[: len(near)]
        return x[:m], float(cost @ x) + 0.5 * float(x[:m] @ linear.curvature @ x[:m])

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
            fall = self.merit(state) - state.cost - predicted
            if fall < max(ENOUGH, 0.02 * self.price * float(state.violations.max())):
                # the best motion, or one that would rather pay than meet its limits
                if float(state.violations.max()) < MET or self.price >= PRICES[1]:
                    return
                self.price *= 4.0
                continue
            found = self._after_step(state, linear, step, penalty, fall)
            ratio = (self.merit(state) - self.merit(found)) / fall
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
                if (self.merit(state) - self.merit(found)) / fall > 0.9:
                    break
                step = self.step(self.corrected(linear, step, last), penalty)[0]
                last = self.state(_moved(state.motion, step), derivatives=False)
                found = min(found, last, key=self.merit)
        except EquilibriumError:
            return state
        return found


def _moved(motion: JointSpline, step: RealArray) -> JointSpline:
    """The motion after a step of the variables."""
    coefficients = motion.coefficients.copy()
    coefficients[REST:-REST] += step[:-1].reshape(2, -1).T
    return JointSpline(coefficients, motion.duration + float(step[-1]), motion.degree)


LOOSE, FALL = 2e-5, 4.0
"""Bound of the residual vibration [m] in the first stages, and about how much it falls from each to the next."""

NODES = 9
"""Number of variants that the programmes have: 7 payloads within 30 % leave 1 µm of residual vibration between them."""

CHECKED = np.array([3e-4, 1e-4, 1e-4, 1e-4, 1.5e-2, 1e-3, *[3e-4] * 5])
"""Violations, in the order of `GROUPS`, up to which the limits count as met on the fine grid: 15 µm, and 5 % of the residual."""

ROUNDS = 4
"""Largest number of evaluations of all variants on the fine grid."""

FINER = 2
"""How much finer that grid is."""


@dataclass(frozen=True, eq=False)
class Improvement:
    """A motion on the way to the best one.

    Attributes:
        motion: the joint references.
        violations: largest relative violation of each of `GROUPS` among the variants that were considered; 0 where it is met.
        residual: bound of the displacement of the end effector by vibration after the motion, of these variants [m].
        checked: whether all variants meet all limits on the fine grid.
    """

    motion: JointSpline
    violations: Mapping[str, float]
    residual: float
    checked: bool


def optimal_motion(
    robots: Sequence[RobotVariant],
    limits: MotionLimits,
    start: JointSpline,
    nodes: Sequence[int] | None = None,
    *,
    parts: int = 2,
    iterations: int = 40,
    loose: float = LOOSE,
    aim: Aim = "time",
) -> Iterator[Improvement]:
    """Joint references that are better and better within limits that hold for all robots.

    Args:
        robots: the robots; those of one scene follow each other, by payload.
        limits: the limits, with torques for all robots.
        start: first motion; it may violate limits, and half the duration of a usual motion serves well.
        nodes: indices of the robots that the programmes have; None for `NODES` that are denser near both ends.
        parts: steps of the integration for each interval of the spline.
        iterations: largest number of programmes in each stage.
        loose: bound of the residual vibration [m] in the first stages; the last bound is the least. Without a larger one the first
            motion is taken to be near the best one.
        aim: what is minimised; all but time in the duration of the first motion.

    Yields:
        Motions on the way; the last one with ``checked`` is the best that meets all limits.

    Raises:
        EquilibriumError: the first motion has no elastic motion.
    """
    chosen = np.array(spread(len(robots), NODES) if nodes is None else nodes)
    motion, loose = start, max(limits.residual, loose)
    # few variants, then all nodes, with a bound that falls
    levels = max(1, round(math.log(loose / limits.residual, FALL)))
    bounds = np.geomspace(loose, limits.residual, levels + 1)[:-1].tolist()
    stages = [(chosen[spread(len(chosen), 3)], loose), *((chosen, bound) for bound in bounds)]
    if loose == limits.residual:
        # the first motion is near the best one
        stages = []
    penalty = PENALTY[0]
    for few, residual in stages:
        stage = _stage(robots, replace(limits, residual=residual), motion, few, start.duration, parts, aim)
        for state in stage.improvements(motion, iterations, penalty):
            motion = state.motion
            yield _improvement(stage, state)
        penalty = max(PENALTY[0], min(4.0 * stage.penalty, 10.0))
    # all variants on the fine grid
    fine = _stage(robots, limits, motion, np.arange(len(robots)), start.duration, FINER * parts, aim)
    tight, exact = limits, fine.state(motion, derivatives=False)
    for _ in range(ROUNDS):
        stage = _stage(robots, tight, motion, chosen, start.duration, parts, aim)
        stage.vibration.error = exact.response.end[chosen] - stage.state(motion, derivatives=False).response.end
        for state in stage.improvements(motion, iterations, penalty):
            motion = state.motion
            yield _improvement(stage, state)
        exact = fine.state(motion, derivatives=False)
        met = bool((exact.violations <= CHECKED).all())
        yield replace(_improvement(fine, exact), checked=met)
        if met:
            return
        # the worst variants join the nodes, and what else lies between them tightens the limits
        missed = [name for name, is_missed in zip(GROUPS, exact.violations > CHECKED, strict=True) if is_missed]
        residuals, loads = fine.vibration.largest(exact.response.end), fine.rows.loads(motion, exact.response)
        worst, excess = {int(residuals.argmax())}, dict[str, float]()
        if "residual" in missed:
            share = float(max(residuals[chosen].max(), tight.residual) / residuals.max())
            excess["residual"] = 1.0 / float(np.clip(share, 0.5, 0.95))
        for name in loads.keys() & {*missed}:
            size = np.abs(loads[name])
            excess[name] = float(size.max()) / 0.9998
            worst.add(int(np.unravel_index(size.argmax(), size.shape)[0]))
        tight, chosen = tight.tightened(excess), np.unique([*chosen, *worst])


def spread(count: int, number: int) -> list[int]:
    """Indices of a number of things in a row of a count, denser near both ends (Chebyshev's nodes)."""
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(number) + 0.5) / number) / np.cos(0.5 * np.pi / number)
    return sorted({int(k) for k in np.rint(nodes * (count - 1))}) if number > 1 else [(count - 1) // 2]


def _stage(
    robots: Sequence[RobotVariant],
    limits: MotionLimits,
    motion: JointSpline,
    chosen: NDArray[np.intp],
    unit: float,
    parts: int,
    aim: Aim,
) -> Stage:
    elastic = FleetResponse([robots[int(k)] for k in chosen], motion.coefficients[0], parts * motion.intervals)
    return Stage(elastic, limits.of_variants(chosen), motion, unit, aim)


def _improvement(stage: Stage, state: State) -> Improvement:
    residual = float(stage.vibration.largest(state.response.end).max(initial=0.0))
    return Improvement(state.motion, dict(zip(GROUPS, state.violations.tolist(), strict=True)), residual, checked=False)

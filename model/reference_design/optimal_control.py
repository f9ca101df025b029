"""Optimal joint references of one motion or of a cycle, within limits that hold for several variants of a robot, by sequential convex
programming.

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

A cycle has several ways, each with its own robots, first motion and limits: the programmes have the variables of all, and RMS torques and
energies of the whole cycle with its pauses (`MotorLoads`). What a way leaves of vibration decays in the pause after it, the rest
swings on in the next way, and so on round the cycle (`LeftVibration`): the bounds are those of the periodic motion.

Sources: J. Nocedal and S. Wright, *Numerical Optimization*, Springer 2006, sections 15.6 and 18.5; R. Fletcher and E. Sainz de la
Maza, Nonlinear programming and nonsmooth optimization by successive linear programming, Mathematical Programming 43 (1989).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from flexfmu.model.reference_design.elastic_response import (
    LINK_LOADS,
    METHOD,
    FleetResponse,
    Response,
    Rest,
    RobotVariant,
    VariantModel,
    free_modes,
    free_motion,
    free_systems,
    joined,
)
from flexfmu.model.reference_design.joint_spline import DesignedMotion
from flexfmu.model.reference_design.quadratic_programme import solve_quadratic
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.motor import Motor
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import RealArray

Distances = Callable[[RealArray], tuple[RealArray, RealArray]]
"""Points of ways (P, N, 2) [m] → distances (K, P, N) [m], negative where the end effector must not be, and their gradients (K, P, N, 2)."""

GROUPS = (
    "torque", "speed", "acceleration", "jerk", "clearance", "residual", "rms_torque", "power", "energy", "supply_power",
    "regenerated_power", "regenerated_energy", "motor_torque", "motor_rms_torque", *LINK_LOADS,
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

OF_CYCLE: Mapping[str, str] = {
    "rms_torque": "square_torque",
    "motor_rms_torque": "square_motor_torque",
    "energy": "energy",
    "regenerated_energy": "regenerated_energy",
}
"""Loads of the whole cycle, not of an instant, with what their ways add to them."""

ROOTS, TINY = ("rms_torque", "motor_rms_torque"), 1e-9
"""Those that are roots of means over its time, and an RMS torque that is none [N m, or 1 of motors]."""

SLOW = 6.0
"""Modes up to this multiple of a variant's lowest frequency count; smooth references don't excite faster ones."""


@dataclass(frozen=True)
class Drives:
    """The motors of both joints with their gears; figures are those of the motors' shafts.

    A gear of ratio i and efficiency η transmits a torque τ of the joint as τ / (i η) while power flows into the robot, as τ η / i while it
    flows back, and as τ / i at rest; the rotor of inertia J adds J i q̈, see `flexfmu.cosim.metrics.motors`.

    Attributes:
        motors: of both joints.
        inertia: inertia of motors that the robot's torques contain [kg m²].
    """

    motors: tuple[Motor, Motor]
    inertia: float = 0.0

    def torque(self, speed: RealArray, acceleration: RealArray, torque: RealArray) -> tuple[RealArray, ...]:
        """Torques of the shafts (P, N, 2) [N m], and their derivatives by acceleration and torque of the joints.

        Args:
            speed, acceleration: of the joints (N, 2) [rad/s, rad/s²].
            torque: of the joints (P, N, 2) [N m].
        """
        ratio, efficiency, rotor = (
            np.array([getattr(motor, name) for motor in self.motors])
            for name in ("gear_ratio", "gear_efficiency", "rotor_inertia")
        )
        load = torque - self.inertia * acceleration
        factor = efficiency ** -np.sign(load * speed) / ratio
        at_shaft = factor * load + rotor * ratio * acceleration
        return at_shaft, rotor * ratio - self.inertia * factor, factor

    def largest(self, speed: RealArray) -> tuple[RealArray, RealArray]:
        """The largest torques of the shafts (N, 2) [N m] at speeds of the joints (N, 2) [rad/s], and their derivatives by the speeds."""
        pairs = [each.largest_torque(each.gear_ratio * v) for each, v in zip(self.motors, speed.T, strict=True)]
        torque, slope = (np.stack(each, axis=-1) for each in zip(*pairs, strict=True))
        return torque, slope * [each.gear_ratio for each in self.motors]

    @property
    def continuous(self) -> RealArray:
        """The torques that the shafts can hold for ever (2,) [N m]."""
        return np.array([each.continuous_torque for each in self.motors])


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of a motion for P variants.

    Attributes:
        torque: largest magnitude of both motor torques (P, 2) [N m].
        speed, acceleration, jerk: largest magnitudes of the joint references [rad/s, rad/s², rad/s³]; one or one for each joint.
        residual: largest displacement of the end effector by vibration after the motion [m].
        distances: to what the end effector must keep clear of.
        loads: largest values of further figures of `MotorLoads` at each instant, by name.
        pause: time at rest after the motion [s], which RMS torques contain.
        settled_within: time after the motion from which the residual vibration counts [s].
        drives: the motors, for their figures; None for none.
    """

    torque: RealArray
    speed: float | RealArray
    acceleration: float | RealArray
    jerk: float | RealArray
    residual: float
    distances: Distances
    loads: Mapping[str, RealArray] = field(default_factory=dict)
    pause: float = 0.0
    settled_within: float = 0.0
    drives: Drives | None = None

    def tightened(self, factors: Mapping[str, float]) -> MotionLimits:
        """The limits, each divided by a factor, 1 where there is none; distances are shorter by ``clearance`` [m]."""
        names, distances = ("torque", "speed", "acceleration", "jerk", "residual"), self.distances

        def shorter(points: RealArray) -> tuple[RealArray, RealArray]:
            distance, gradient = distances(points)
            return distance - factors["clearance"], gradient

        return replace(
            self,
            distances=shorter if "clearance" in factors else distances,
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
    ``square_torque`` (P, 2) [N² m² s], the integral of its square; ``energy`` (P,) [J] that they give, without what they take back;
    ``supply_power`` and ``regenerated_power`` (P, N) [W] of both together, zero where the other one flows, and ``regenerated_energy`` (P,)
    [J], the integral of the latter; ``motor_torque`` (P, N, 2) of the shafts relative to the largest at their speeds, and
    ``square_motor_torque`` (P, 2) [s], the integral of the square relative to the torque that they can hold for ever; and those of `LINK_LOADS`.

    Args:
        fractions: instants (N,), the stages of equal steps, as fractions of the duration.
        holding: torques at rest after the motion (P, 2) [N m].
        pause: time at rest after the motion [s].
        drives: the motors, for their figures.
        link_loads: names of those that responses have.
    """

    def __init__(
        self,
        fractions: RealArray,
        holding: RealArray | float = 0.0,
        pause: float = 0.0,
        drives: Drives | None = None,
        link_loads: tuple[str, ...] = (),
    ) -> None:
        steps = len(fractions) // 3
        self._fractions, self._holding, self._pause, self._drives = fractions, holding, pause, drives
        self.weights = np.tile(METHOD.whole, steps) / steps
        edges = np.cumsum([0, *(LINK_LOADS[name][0] for name in link_loads)]).tolist()
        self._link_loads = {name: slice(*each) for name, each in zip(link_loads, pairwise(edges), strict=True)}

    @property
    def drives(self) -> Drives:
        """The motors, where there are any."""
        assert self._drives is not None
        return self._drives

    def values(self, names: Iterable[str], motion: DesignedMotion, response: Response) -> dict[str, RealArray]:
        """The figures of these names."""
        return self.of_references(names, motion.evaluate(self._fractions), motion.duration, response)

    def of_references(
        self, names: Iterable[str], references: RealArray, duration: float, response: Response
    ) -> dict[str, RealArray]:
        """The figures for joint references (3, N, 2) [rad, rad/s, rad/s²] of a duration [s], and the response to them."""
        torque, (_, speed, acceleration) = response.torque, references
        power, weights = torque * speed, duration * self.weights
        both, rest = power.sum(axis=2), np.zeros(2)

        def shafts() -> RealArray:
            return self.drives.torque(speed, acceleration, torque)[0]

        find: dict[str, Callable[[], RealArray]] = {
            "torque": lambda: torque,
            "power": lambda: power,
            "square_torque": lambda: (
                np.einsum("n,pnj->pj", weights, torque**2) + self._pause * np.square(self._holding)
            ),
            "energy": lambda: np.einsum("n,pnj->p", weights, np.maximum(power, 0.0)),
            "supply_power": lambda: np.maximum(both, 0.0),
            "regenerated_power": lambda: np.maximum(-both, 0.0),
            "regenerated_energy": lambda: np.maximum(-both, 0.0) @ weights,
            "motor_torque": lambda: shafts() / self.drives.largest(speed)[0],
            "square_motor_torque": lambda: (
                np.einsum("n,pnj->pj", weights, (shafts() / self.drives.continuous) ** 2)
                + self._pause
                * (self.drives.torque(rest, rest, np.asarray(self._holding))[0] / self.drives.continuous) ** 2
            ),
        }
        return {
            name: response.loads[..., self._link_loads[name]] if name in self._link_loads else find[name]()
            for name in names
        }

    def speed_derivatives(self, motion: DesignedMotion) -> RealArray:
        """Derivatives of the joint speeds (N, 2, m)."""
        return motion.derivatives(self._fractions)[:, 2:4]

    def shafts(self, motion: DesignedMotion, response: Response) -> tuple[RealArray, RealArray]:
        """Torques of the shafts (P, N, 2) [N m], and their derivatives by the variables."""
        _, speed, acceleration = motion.evaluate(self._fractions)
        torque, by_acceleration, by_torque = self.drives.torque(speed, acceleration, response.torque)
        acceleration_by = motion.derivatives(self._fractions)[:, 4:6]
        return torque, by_acceleration[..., np.newaxis] * acceleration_by + by_torque[
            ..., np.newaxis
        ] * response.torque_by

    def _shares(self, motion: DesignedMotion, response: Response) -> RealArray:
        """Derivatives of the torques of the shafts relative to the largest at their speeds."""
        torque, torque_by = self.shafts(motion, response)
        largest, slope = self.drives.largest(motion.evaluate(self._fractions, 1)[1])
        by_speed = -torque * slope / largest**2
        return torque_by / largest[..., np.newaxis] + by_speed[..., np.newaxis] * self.speed_derivatives(motion)

    def derivatives(self, names: Iterable[str], motion: DesignedMotion, response: Response) -> dict[str, RealArray]:
        """Their derivatives by the m variables, in one more dimension."""
        torque, by, duration = response.torque, response.torque_by, motion.duration
        speed, speed_by = motion.evaluate(self._fractions, 1)[1], self.speed_derivatives(motion)
        power = torque * speed
        both, weights = power.sum(axis=2), duration * self.weights

        @cache
        def power_by() -> RealArray:
            return np.asarray(by * speed[..., np.newaxis] + torque[..., np.newaxis] * speed_by)

        @cache
        def both_by() -> RealArray:
            return np.asarray(power_by().sum(axis=2))

        def squares(each: RealArray, each_by: RealArray) -> RealArray:
            # the last variable is the duration
            whole = 2.0 * np.einsum("n,pnj,pnjm->pjm", weights, each, each_by)
            whole[..., -1] += np.einsum("n,pnj->pj", self.weights, each**2)
            return np.asarray(whole)

        def integral(flow: RealArray, flow_by: RealArray) -> RealArray:
            """Of the positive part of flows (P, N, ...)."""
            axes = "pnj"[: flow.ndim]
            whole = np.einsum(f"n,{axes},{axes}m->pm", weights, (flow > 0.0) * 1.0, flow_by)
            whole[:, -1] += np.einsum(f"n,{axes}->p", self.weights, np.maximum(flow, 0.0))
            return np.asarray(whole)

        find: dict[str, Callable[[], RealArray]] = {
            "torque": lambda: by,
            "power": power_by,
            "square_torque": lambda: squares(torque, by),
            "energy": lambda: integral(power, power_by()),
            "supply_power": lambda: (both > 0.0)[..., np.newaxis] * both_by(),
            "regenerated_power": lambda: (both < 0.0)[..., np.newaxis] * -both_by(),
            "regenerated_energy": lambda: integral(-both, -both_by()),
            "motor_torque": lambda: self._shares(motion, response),
            "square_motor_torque": lambda: (
                squares(*self.shafts(motion, response)) / self.drives.continuous[:, np.newaxis] ** 2
            ),
        }
        return {
            name: response.loads_by[:, :, self._link_loads[name]] if name in self._link_loads else find[name]()
            for name in names
        }


@dataclass(frozen=True, eq=False)
class Inequalities:
    """Inequalities at a motion: those that can decide, of all (N,), with values g (R,), indices of their groups (R,), derivatives (R, m)."""

    deciding: NDArray[np.bool_]
    values: RealArray
    groups: NDArray[np.intp]
    jacobian: RealArray


class LimitRows:
    """The limits at each instant, row by row: references, loads of the motors, clearance.

    Args:
        limits: the limits.
        fractions: instants (N,) as fractions of the duration.
        motors: the figures of the motors' loads.
    """

    def __init__(self, limits: MotionLimits, fractions: RealArray, motors: MotorLoads) -> None:
        self.limits, self._fractions, self._motors = limits, fractions, motors
        self._largest = np.array(
            [np.broadcast_to(each, 2) for each in (limits.speed, limits.acceleration, limits.jerk)]
        )
        # of each load at all instants; link loads have one limit each for all their places
        units = {"torque": limits.torque, **limits.loads}
        self._units = {
            name: each[:, np.newaxis, np.newaxis] if name in LINK_LOADS else each[:, np.newaxis]
            for name, each in units.items()
        }

    def values(self, motion: DesignedMotion, response: Response) -> tuple[RealArray, NDArray[np.intp]]:
        """g (R,) and the groups (R,)."""
        parts = self._parts(motion, response)
        groups = [np.full(each.size, GROUPS.index(name)) for name, each in parts]
        return np.concatenate([each.ravel() for _, each in parts]), np.concatenate(groups)

    def loads(self, motion: DesignedMotion, response: Response) -> dict[str, RealArray]:
        """Each load relative to its limit, with its sign, by name."""
        found = self._motors.values(self._units, motion, response)
        return {name: each / self._units[name] for name, each in found.items()}

    def rows(self, motion: DesignedMotion, response: Response) -> Inequalities:
        """The inequalities with derivatives."""
        deciding = [_deciding(name, each) for name, each in self._parts(motion, response)]
        conditions_by, found = motion.conditions()[1], list[RealArray]()
        m = conditions_by.shape[1]
        rates = motion.rates(self._fractions), motion.rates_by(self._fractions), self._largest
        for each, rates_by, largest in zip(*rates, strict=True):
            found.append((np.sign(each)[..., np.newaxis] * rates_by / largest[:, np.newaxis]).reshape(-1, m))
        found.append(conditions_by)
        by = self._motors.derivatives(self._units, motion, response)
        for (name, each), some in zip(self.loads(motion, response).items(), deciding[4:], strict=False):
            found.append((np.sign(each) / self._units[name])[some][:, np.newaxis] * by[name][some])
        some, gradient = deciding[-1], self.limits.distances(response.position)[1]
        _, variant, instant = np.nonzero(some)
        found.append(-np.einsum("rj,rjm->rm", gradient[some], response.position_by[variant, instant]) / DEPTH)
        which = np.concatenate([each.ravel() for each in deciding])
        values, groups = self.values(motion, response)
        return Inequalities(which, values[which], groups[which], np.concatenate(found))

    def curvature(
        self, motion: DesignedMotion, response: Response, prices: RealArray, of_cycle: Mapping[str, RealArray]
    ) -> RealArray:
        """The curvature (m, m) of the loads, its positive part.

        Torques and speeds count as linear (Gauss-Newton): mean squares of torques, and products of torques and speeds are curved.

        Args:
            prices: of each row (R,).
            of_cycle: price of each unit of ``square_torque`` and ``square_motor_torque`` (P, 2), and of ``energy`` and
                ``regenerated_energy`` (P,).
        """
        by, speed_by = response.torque_by, self._motors.speed_derivatives(motion)
        products = np.zeros(response.torque.shape)
        first, share = 0, motion.duration * self._motors.weights[:, np.newaxis]
        power = self._motors.values(["power"], motion, response)["power"]
        for name, each in self._parts(motion, response):
            price, first = prices[first : first + each.size].reshape(each.shape), first + each.size
            if name in ("power", "supply_power", "regenerated_power"):
                price = price / self._units[name]
                if name == "power":
                    products += np.sign(power) * price
                else:
                    products += ((1.0 if name == "supply_power" else -1.0) * price)[..., np.newaxis]
        if "energy" in of_cycle:
            products += of_cycle["energy"][:, np.newaxis, np.newaxis] * share * (power > 0.0)
        if "regenerated_energy" in of_cycle:
            flows_back = power.sum(axis=2, keepdims=True) < 0.0
            products -= of_cycle["regenerated_energy"][:, np.newaxis, np.newaxis] * share * flows_back
        squares = np.zeros_like(products)
        if "square_torque" in of_cycle:
            squares += 2.0 * of_cycle["square_torque"][:, np.newaxis] * share
        found = np.einsum("pnj,pnja,pnjb->ab", squares, by, by, optimize=True)
        if "square_motor_torque" in of_cycle:
            own = 2.0 * of_cycle["square_motor_torque"][:, np.newaxis] * share / self._motors.drives.continuous**2
            own_by = self._motors.shafts(motion, response)[1]
            found += np.einsum("pnj,pnja,pnjb->ab", own, own_by, own_by, optimize=True)
        p, n, j = np.nonzero(products)
        cross = (products[p, n, j, np.newaxis] * by[p, n, j]).T @ speed_by[n, j]
        values, vectors = np.linalg.eigh(found + cross + cross.T)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)

    def _parts(self, motion: DesignedMotion, response: Response) -> list[tuple[str, RealArray]]:
        """The group of each part of the rows, and g."""
        rates = GROUPS[1:4], motion.rates(self._fractions), self._largest
        found = [(name, np.abs(each) / largest - 1.0) for name, each, largest in zip(*rates, strict=True)]
        found.append(("speed", motion.conditions()[0]))
        found += [(name, np.abs(each) - 1.0) for name, each in self.loads(motion, response).items()]
        return [*found, ("clearance", -self.limits.distances(response.position)[0] / DEPTH)]


def _deciding(name: str, values: RealArray) -> NDArray[np.bool_]:
    """Which of a part's rows can decide: at each instant those of the `WORST` variants."""
    axis = 1 if name == "clearance" else 0
    if name in GROUPS[1:4] or values.shape[axis] <= WORST:
        return np.ones(values.shape, dtype=bool)
    least = np.partition(values, -WORST, axis=axis).take([-WORST], axis=axis)
    return np.asarray(values >= least)


class ResidualVibration:
    """Modal amplitudes of the vibration that remains at the end, in displacements of the end effector.

    Args:
        models: the variants of each scene.
        end: joint angles after the motion (2,) [rad].
        settled_within: time after the motion from which the vibration counts [s].
    """

    def __init__(self, models: Sequence[VariantModel], end: RealArray, settled_within: float = 0.0) -> None:
        self.rests, self._settled_within = [model.rest(end) for model in models], settled_within
        # from elastic coordinates and their rates at the end: (P, 2, k, n)
        self.matrices = joined([_to_amplitudes(rest, settled_within) for rest in self.rests])
        self.holding = joined([rest.torque for rest in self.rests])
        self._rest = joined([rest.elastic for rest in self.rests])
        self.error = np.zeros((len(self._rest), 2, self._rest.shape[1]))

    def away(self, end: RealArray) -> RealArray:
        """States at the end (P, 2, n) relative to rest, the grid's error added."""
        away = end + self.error
        away[:, 0] -= self._rest
        return away

    def largest(self, end: RealArray) -> RealArray:
        """Bounds (P,) of the displacement of the end effector after the motion [m]."""
        return bounds(self.matrices, self.away(end))

    @cached_property
    def _moved(self) -> RealArray:
        """End effector at instants after the motion by elastic coordinates and rates at its end, (P, times, 2, 2, n)."""
        step = _instant(self.rests[0])
        return joined([free_motion(rest, self._settled_within, step, INSTANTS) for rest in self.rests])

    def peaks(self, states: RealArray, robots: NDArray[np.intp]) -> RealArray:
        """The largest displacements (C,) [m] after the motion by states (C, 2, n) of robots (C,)."""
        places = np.einsum("ctxin,cin->ctx", self._moved[robots], states, optimize=True)
        return np.asarray(np.linalg.norm(places, axis=2).max(axis=1))


def _applied(matrices: RealArray, states: RealArray) -> RealArray:
    """Modal places and rates (P, 2, k) [m] of states (P, 2, n)."""
    return np.asarray((matrices @ states[..., np.newaxis])[..., 0])


def bounds(matrices: RealArray, states: RealArray) -> RealArray:
    """Bounds (P,) [m] of the displacement by states (P, 2, n) after the motion, with matrices of `ResidualVibration`."""
    return _sizes(_applied(matrices, states))


def _sizes(amplitudes: RealArray) -> RealArray:
    """Bounds (P,) [m] of the displacement by modal places and rates (P, 2, k)."""
    return np.asarray(np.linalg.norm(amplitudes, axis=1).sum(axis=-1))


class LeftVibration:
    """What the ways of a cycle leave of vibration in the next, in the periodic motion.

    The payload changes at the end of the pause, carried by what it lies on: elastic coordinates keep their distance from rest, and their rates.

    Args:
        ends: the robots of each way at rest after it, by scene.
        pauses: time at rest after each way [s].
        of_case: index of the robot of each case for each way (W, C).
    """

    def __init__(
        self, ends: Sequence[Sequence[Rest]], pauses: Sequence[float], of_case: Sequence[NDArray[np.intp]]
    ) -> None:
        self.of_case, self._handed = of_case, list[RealArray]()
        for rests, pause, cases in zip(ends, pauses, of_case, strict=True):
            systems = [free_systems(rest) for rest in rests]
            decays = joined(
                [expm(each * pause).reshape(-1, 2, n, 2, n) for each in systems for n in [each.shape[1] // 2]]
            )
            self._handed.append(decays[cases])
        self._matrix: RealArray | None = None

    def renew(self, transfers: Sequence[RealArray]) -> None:
        """Take new transfers (P, 2, n, 2, n) from start to end of each way, see `ElasticResponse.transfer`."""
        count, cases, _, n, *_ = (len(transfers), *self._handed[0].shape)
        size = 2 * n
        moved = np.zeros((cases, count * size, count * size))
        for w, handed in enumerate(self._handed):
            k = (w + 1) % count
            both = transfers[k][self.of_case[k]].reshape(cases, size, size) @ handed.reshape(cases, size, size)
            moved[:, k * size : (k + 1) * size, w * size : (w + 1) * size] += both
        inverse = np.linalg.inv(np.eye(count * size) - moved)
        self._matrix = np.asarray(inverse).reshape(cases, count, size, count, size)

    def periodic(self, states: Sequence[RealArray]) -> list[RealArray]:
        """States at the ends of the ways (C, 2, n, ...) in the periodic motion, by those from rest (P, 2, n, ...)."""
        assert self._matrix is not None
        shape = states[0].shape[1:]
        own = np.stack(
            [each[k].reshape(len(k), shape[0] * shape[1], -1) for k, each in zip(self.of_case, states, strict=True)], 1
        )
        found = np.einsum("cusvt,cvtm->cusm", self._matrix, own, optimize=True)
        return [found[:, w].reshape(len(found), *shape) for w in range(found.shape[1])]


def _to_amplitudes(rest: Rest, settled_within: float) -> RealArray:
    """Matrices (P, 2, k, n) from elastic coordinates and their rates to displacements of the end effector by the k slowest modes, which
    have decayed for a time [s]."""
    modes, n = free_modes(rest), rest.elastic.shape[1]
    count = int((modes.frequencies < SLOW * modes.frequencies[:, :1]).any(axis=0).sum())
    size = np.linalg.norm(modes.displacements, axis=1)[:, :count, np.newaxis]
    if settled_within:
        shapes = np.linalg.inv(modes.coordinates)
        damping = np.einsum("pik,pij,pjk->pk", shapes, rest.jacobian[:, :n, n : 2 * n], shapes)
        size = size * np.exp(-0.5 * settled_within * damping)[:, :count, np.newaxis]
    coordinates = modes.coordinates[:, :count] * size
    return np.stack([coordinates, coordinates / modes.frequencies[:, :count, np.newaxis]], axis=1)


INSTANTS, A_PERIOD = 200, 16
"""Instants after the motion at which its vibration is examined, and how many of them the faster of the two lowest modes has in a period."""


def _instant(rest: Rest) -> float:
    """The time [s] between these instants."""
    return 2.0 * math.pi / A_PERIOD / float(free_modes(rest).frequencies[:, :2].max(initial=1.0))


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

    def __init__(self, aim: Aim, start: DesignedMotion, response: Response, fractions: RealArray) -> None:
        self._aim, self._motors = aim, MotorLoads(fractions)
        self._name = "power" if aim == "energy" else "torque"
        self._weights = self._motors.weights[:, np.newaxis] / len(response.torque)
        self._largest = np.abs(response.torque).max()
        if aim == "energy":
            self._largest *= np.abs(start.evaluate(fractions, 1)[1]).max()
        self._unit = 1.0
        self._unit = self.value(start, response)

    def value(self, motion: DesignedMotion, response: Response) -> float:
        """The cost of a motion."""
        return float((self._weights * self._costs(self._figures(motion, response))[0]).sum()) / self._unit

    def derivatives(self, motion: DesignedMotion, response: Response) -> tuple[RealArray, RealArray]:
        """Gradient (m,) of the cost, and the positive part of its curvature (m, m)."""
        figures = self._figures(motion, response)
        by = self._motors.derivatives([self._name], motion, response)[self._name] / self._largest
        _, slopes, curvatures = (self._weights * each / self._unit for each in self._costs(figures))
        flat = by.reshape(-1, by.shape[-1])
        return np.asarray(slopes.ravel() @ flat), np.asarray((flat.T * curvatures.ravel()) @ flat)

    def _figures(self, motion: DesignedMotion, response: Response) -> RealArray:
        """Torques, or for the energy powers, (P, N, 2), relative to the largest of the first motion."""
        return np.asarray(self._motors.values([self._name], motion, response)[self._name] / self._largest)

    def _costs(self, y: RealArray) -> tuple[RealArray, RealArray, RealArray]:
        """A convex function of figures, with its first and second derivatives."""
        if self._aim == "energy":
            root = np.sqrt(y**2 + ROUNDING**2)
            return 0.5 * (y + root), 0.5 * (1.0 + y / root), 0.5 * ROUNDING**2 / root**3
        power = PEAK if self._aim == "torque" else 2
        return y**power, power * y ** (power - 1), power * (power - 1) * y ** (power - 2)


Motions = tuple[DesignedMotion, ...]
"""One for each way."""


@dataclass(frozen=True, eq=False)
class Way:
    """A motion, alone or of a cycle.

    Attributes:
        robots: the robots; those of one scene follow each other, by payload.
        limits: the limits, with torques for all robots.
        start: first motion; it may violate limits, and half the duration of a usual motion serves well.
        of_case: index of the robot of each case (C,), the payload that is carried through the cycle; None for one case a robot.
    """

    robots: Sequence[RobotVariant]
    limits: MotionLimits
    start: DesignedMotion
    of_case: NDArray[np.intp] | None = None

    @property
    def cases(self) -> NDArray[np.intp]:
        """Index of the robot of each case (C,)."""
        return np.arange(len(self.robots)) if self.of_case is None else self.of_case

    def of_cases(self, chosen: NDArray[np.intp]) -> Way:
        """The way with the robots of some cases."""
        index, cases = np.unique(self.cases[chosen], return_inverse=True)
        return replace(
            self, robots=[self.robots[int(k)] for k in index], limits=self.limits.of_variants(index), of_case=cases
        )


@dataclass(frozen=True, eq=False)
class State:
    """Motions, and what they cost in units of the start's; loads of the cycle relative to their limits."""

    motions: Motions
    responses: tuple[Response, ...]
    loads: Mapping[str, RealArray]
    amplitudes: tuple[RealArray, ...]
    violations: RealArray
    cost: float


@dataclass(frozen=True, eq=False)
class Linear:
    """The limits, linearised at motions; rows have the variables of their way, all else has those of all.

    Attributes:
        rows: of each way.
        loads, loads_by: g (L,) of the loads of the cycle with their derivatives (L, m), and the indices of their groups (L,).
        amplitudes, amplitudes_by: modal amplitudes of each way (C, 2, k), with derivatives (C, 2, k, m).
        slope, curvature: of the cost, (m,) and (m, m).
        room: largest steps of the variables, down and up (m,).
    """

    rows: tuple[Inequalities, ...]
    loads: RealArray
    load_groups: NDArray[np.intp]
    loads_by: RealArray
    amplitudes: tuple[RealArray, ...]
    amplitudes_by: tuple[RealArray, ...]
    slope: RealArray
    curvature: RealArray
    room: tuple[RealArray, RealArray]


class _WayProgramme:
    """What a stage knows of one way: the response, the limits at each instant, the vibration after it, the columns of its variables.

    Args:
        way: the way.
        parts: steps of the integration for each interval of the spline.
        first: its first column.
        unit: duration of a first motion [s].
        aim: what is minimised.
    """

    def __init__(self, way: Way, parts: int, first: int, unit: float, aim: Aim) -> None:
        start, self.limits, self.cases = way.start, way.limits, way.cases
        before, after = start.evaluate([0.0, 1.0], 0)[0]
        link_loads = tuple(name for name in LINK_LOADS if name in way.limits.loads)
        self.elastic = FleetResponse(way.robots, before, parts * start.intervals, link_loads)
        self.effort = None
        if aim != "time":
            response = self.elastic.of_motion(start, derivatives=False)
            self.effort = Effort(aim, start, response, self.elastic.fractions)
        models = [part.model for part in self.elastic.parts]
        self.vibration = ResidualVibration(models, after, way.limits.settled_within)
        self.motors = MotorLoads(
            self.elastic.fractions, self.vibration.holding, way.limits.pause, way.limits.drives, link_loads
        )
        self.rows = LimitRows(way.limits, self.elastic.fractions, self.motors)
        self.scale, self.metric = start.scale(unit), start.metric(unit)
        self.columns = slice(first, first + len(self.scale))


def weight_of_squares(name: str, period: float, drives: Drives | None) -> tuple[RealArray, RealArray]:
    """What an integral of squares counts for one of `ROOTS` in a cycle, of both joints (2,) [1/s], and its derivative by the period [s]."""
    if name == "rms_torque" or drives is None:
        return np.full(2, 1.0 / period), np.full(2, -1.0 / period**2)
    weight, slope = zip(*(each.heating(period) for each in drives.motors), strict=True)
    return np.array(weight), np.array(slope)


class Stage:
    """The limits of some cases, and their programmes.

    Args:
        ways: the ways with the robots of these cases.
        loads: limits of loads of the cycle for these cases, by name.
        parts: steps of the integration for each interval of the splines.
        units: durations [s] that cost 1 in all; the effort of the first motions costs 1.
        aim: what is minimised.
    """

    def __init__(
        self, ways: Sequence[Way], loads: Mapping[str, RealArray], parts: int, units: Sequence[float], aim: Aim = "time"
    ) -> None:
        self.ways = list[_WayProgramme]()
        for way, unit in zip(ways, units, strict=True):
            first = self.ways[-1].columns.stop if self.ways else 0
            self.ways.append(_WayProgramme(way, parts, first, unit, aim))
        self._limits, self._timed, self.unit = loads, aim == "time", sum(units)
        self.residual = ways[0].limits.residual
        self.price, self.penalty = PRICES[0], PENALTY[0]
        self._prices: tuple[list[RealArray], RealArray] | None = None
        self._scale = np.concatenate([way.scale for way in self.ways])
        self._metric = self._diagonal([way.metric for way in self.ways])
        self.left = None
        if len(ways) > 1:
            ends, pauses = [way.vibration.rests for way in self.ways], [way.limits.pause for way in ways]
            self.left = LeftVibration(ends, pauses, [way.cases for way in self.ways])

    def state(self, motions: Motions, *, derivatives: bool = True, renewed: bool = False) -> State:
        """Evaluate motions; with derivatives, or if it is wanted, with new transfers of vibration from way to way."""
        pairs = list(zip(self.ways, motions, strict=True))
        responses = tuple(way.elastic.of_motion(motion, derivatives=derivatives) for way, motion in pairs)
        if self.left is not None and (derivatives or renewed):
            self.left.renew([way.elastic.transfer(motion.duration) for way, motion in pairs])
        loads, amplitudes = self._loads(motions, responses), self.amplitudes(responses)
        violations = np.zeros(len(GROUPS))
        for way, motion, response in zip(self.ways, motions, responses, strict=True):
            values, groups = way.rows.values(motion, response)
            np.maximum.at(violations, groups, values)
        for name, each in loads.items():
            violations[GROUPS.index(name)] = max(0.0, float(each.max()) - 1.0)
        violations[RESIDUAL] = self._residual_violation(amplitudes)
        if self._timed:
            cost = sum(motion.duration for motion in motions) / self.unit
        else:
            efforts = [
                way.effort.value(motion, response)
                for way, motion, response in zip(self.ways, motions, responses, strict=True)
                if way.effort is not None
            ]
            cost = float(np.mean(efforts))
        return State(motions, responses, loads, amplitudes, violations, cost)

    def amplitudes(self, responses: Sequence[Response]) -> tuple[RealArray, ...]:
        """Modal places and rates (C, 2, k) [m] at the end of each way."""
        pairs = zip(self.ways, self._ends(responses), strict=True)
        return tuple(_applied(way.vibration.matrices[way.cases], each) for way, each in pairs)

    def _ends(self, responses: Sequence[Response]) -> list[RealArray]:
        """States at the end of each way relative to rest (C, 2, n)."""
        states = [way.vibration.away(each.end) for way, each in zip(self.ways, responses, strict=True)]
        return [states[0][self.ways[0].cases]] if self.left is None else self.left.periodic(states)

    def scaled(self, state: State) -> State:
        """The state after the bounds of the vibration, sums over the modes, were scaled to the largest displacements that they bound there."""
        for way, each, bound in zip(self.ways, self._ends(state.responses), map(_sizes, state.amplitudes), strict=True):
            factors = np.ones(len(way.vibration.matrices))
            shares = way.vibration.peaks(each, way.cases) / np.maximum(bound, NO_VIBRATION)
            factors[way.cases] = 0.0
            np.maximum.at(factors, way.cases, np.clip(shares, *SCALED))
            way.vibration.matrices *= factors[:, np.newaxis, np.newaxis, np.newaxis]
        amplitudes, violations = self.amplitudes(state.responses), state.violations.copy()
        violations[RESIDUAL] = self._residual_violation(amplitudes)
        return replace(state, amplitudes=amplitudes, violations=violations)

    def _residual_violation(self, amplitudes: Sequence[RealArray]) -> float:
        residual = max(float(_sizes(each).max(initial=0.0)) for each in amplitudes)
        return max(0.0, residual / self.residual - 1.0) * RESIDUAL_SCALE

    def _loads(self, motions: Motions, responses: Sequence[Response]) -> dict[str, RealArray]:
        """Each load of the cycle, for all cases relative to its limit."""
        found = dict[str, RealArray]()
        for name, limit in self._limits.items():
            whole = sum(
                way.motors.values([OF_CYCLE[name]], motion, response)[OF_CYCLE[name]][way.cases]
                for way, motion, response in zip(self.ways, motions, responses, strict=True)
            )
            whole = np.asarray(whole)
            found[name] = (np.sqrt(whole * self._weight(name, motions)[0]) if name in ROOTS else whole) / limit
        return found

    def _weight(self, name: str, motions: Motions) -> tuple[RealArray, RealArray]:
        return weight_of_squares(name, self._time(motions), self.ways[0].limits.drives)

    def _time(self, motions: Motions) -> float:
        """Duration of the cycle [s]."""
        return sum(motion.duration + way.limits.pause for way, motion in zip(self.ways, motions, strict=True))

    def merit(self, state: State) -> float:
        """The cost, and the price of what isn't met."""
        return state.cost + self.price * float(state.violations.sum())

    def linear(self, state: State) -> Linear:
        """Linearise the limits at motions."""
        triples, m = list(zip(self.ways, state.motions, state.responses, strict=True)), len(self._scale)
        # loads of the cycle
        loads_by = list[RealArray]()
        for name, share in state.loads.items():
            by = np.zeros((*share.shape, m))
            for way, motion, response in triples:
                of_way = way.motors.derivatives([OF_CYCLE[name]], motion, response)[OF_CYCLE[name]]
                by[..., way.columns] += of_way[way.cases]
            if name in ROOTS:
                # a root of a mean square, over a time that has all durations
                root, (weight, slope) = share * self._limits[name], self._weight(name, state.motions)
                by *= weight[:, np.newaxis]
                for way in self.ways:
                    by[..., way.columns.stop - 1] += root**2 * slope / weight
                by /= 2.0 * np.maximum(root, TINY)[..., np.newaxis]
            loads_by.append((by / self._limits[name][..., np.newaxis]).reshape(-1, m))
        groups = [np.full(each.size, GROUPS.index(name)) for name, each in state.loads.items()]
        loads = [each.ravel() - 1.0 for each in state.loads.values()]
        # vibration
        if self.left is None:
            way = self.ways[0]
            amplitudes_by: tuple[RealArray, ...] = ((way.vibration.matrices @ state.responses[0].end_by)[way.cases],)
        else:
            states = []
            for way, _, response in triples:
                by = np.zeros((*response.end_by.shape[:-1], m))
                by[..., way.columns] = response.end_by
                states.append(by)
            pairs = zip(self.ways, self.left.periodic(states), strict=True)
            amplitudes_by = tuple(way.vibration.matrices[way.cases] @ each for way, each in pairs)
        # the cost
        slope, curvatures = np.zeros(m), list[RealArray]()
        for k, (way, motion, response) in enumerate(triples):
            curvature = np.zeros_like(way.metric)
            if way.effort is None:
                slope[way.columns.stop - 1] = 1.0 / self.unit
            else:
                slope[way.columns], curvature = (
                    each / len(triples) for each in way.effort.derivatives(motion, response)
                )
            if self._prices is not None:
                of_rows, of_loads = self._prices
                curvature = curvature + way.rows.curvature(
                    motion, response, of_rows[k], self._of_way(way, state, of_loads)
                )
            curvatures.append(curvature)
        empty, (down, up) = np.zeros((0, m)), zip(*(motion.room for motion in state.motions), strict=True)
        return Linear(
            tuple(way.rows.rows(motion, response) for way, motion, response in triples),
            np.concatenate([np.zeros(0), *loads]),
            np.concatenate([np.zeros(0, dtype=np.intp), *groups]),
            np.concatenate([empty, *loads_by]),
            state.amplitudes,
            amplitudes_by,
            slope,
            self._diagonal(curvatures),
            (np.concatenate(down), np.concatenate(up)),
        )

    def _of_way(self, way: _WayProgramme, state: State, prices: RealArray) -> dict[str, RealArray]:
        """The price of each unit that the robots of a way add to loads of the cycle."""
        found, first = dict[str, RealArray](), 0
        for name, share in state.loads.items():
            price, first = (
                prices[first : first + share.size].reshape(share.shape) / self._limits[name],
                first + share.size,
            )
            if name in ROOTS:
                price = (
                    price * self._weight(name, state.motions)[0] / (2.0 * np.maximum(share * self._limits[name], TINY))
                )
            found[OF_CYCLE[name]] = np.zeros((way.cases.max() + 1, *share.shape[1:]))
            np.add.at(found[OF_CYCLE[name]], way.cases, price)
        return found

    def corrected(self, linear: Linear, step: RealArray, state: State) -> Linear:
        """The linearised limits with their values after a step."""
        rows = []
        for way, motion, response, each in zip(self.ways, state.motions, state.responses, linear.rows, strict=True):
            values, _ = way.rows.values(motion, response)
            values = values[each.deciding] - each.jacobian @ step[way.columns]
            rows.append(replace(each, values=values))
        loads = np.concatenate([np.zeros(0), *(each.ravel() - 1.0 for each in state.loads.values())])
        return replace(
            linear,
            rows=tuple(rows),
            loads=loads - linear.loads_by @ step,
            amplitudes=tuple(now - by @ step for now, by in zip(state.amplitudes, linear.amplitudes_by, strict=True)),
        )

    def step(self, linear: Linear, penalty: float) -> tuple[RealArray, float]:
        """The best step (m,) and the change of the cost, with the price of what isn't met after it, as they predict.

        The multipliers of the rows are kept: they weigh the curvature of the next programme.
        """
        m, slacks = len(self._scale), len(GROUPS)
        near = [np.flatnonzero(each.values > np.where(each.groups == CLEARANCE, -FAR, -NEAR)) for each in linear.rows]
        sizes = [each.shape[0] * each.shape[2] for each in linear.amplitudes]
        size = m + slacks + sum(sizes)
        blocks, right = list[RealArray](), list[RealArray]()
        # limits at instants, of each way
        for way, rows, some in zip(self.ways, linear.rows, near, strict=True):
            block = np.zeros((len(some), size))
            block[:, way.columns] = rows.jacobian[some]
            block[np.arange(len(some)), m + rows.groups[some]] = -1.0
            blocks.append(block)
            right.append(-rows.values[some])
        # loads of the cycle
        block = np.zeros((len(linear.loads), size))
        block[:, :m] = linear.loads_by
        block[np.arange(len(block)), m + linear.load_groups] = -1.0
        blocks.append(block)
        right.append(-linear.loads)
        # half planes of each mode's amplitude; the sum of amplitudes for each case
        scale, normals = RESIDUAL_SCALE / self.residual, np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
        first = m + slacks
        for now, by in zip(linear.amplitudes, linear.amplitudes_by, strict=True):
            cases, _, modes = now.shape
            count = cases * modes
            block = np.zeros((len(DIRECTIONS) * count + cases, size))
            block[:-cases, :m] = scale * np.einsum("id,pikm->dpkm", normals, by).reshape(-1, m)
            bounds = block[:, first : first + count]
            bounds[:-cases] = np.tile(np.eye(count), (len(DIRECTIONS), 1)) * -np.cos(DIRECTIONS[1] / 2)
            bounds[-cases:] = np.kron(np.eye(cases), np.ones(modes))
            block[-cases:, m + RESIDUAL] = -1.0
            blocks.append(block)
            right += [-scale * np.einsum("id,pik->dpk", normals, now).ravel(), np.full(cases, RESIDUAL_SCALE)]
            first += count
        matrix = np.concatenate(blocks)
        # in units of the scale
        unit = np.concatenate([self._scale, np.ones(size - m)])
        quadratic, cost = np.zeros((size, size)), np.zeros(size)
        quadratic[:m, :m] = penalty * self._metric + np.diag(CURVED / self._scale**2) + linear.curvature
        cost[:m], cost[m : m + slacks] = linear.slope, self.price
        if not self._timed:
            # the durations are given
            fixed = [way.columns.stop - 1 for way in self.ways]
            diagonal = quadratic[fixed, fixed]
            cost[fixed], quadratic[fixed], quadratic[:, fixed], matrix[:, fixed] = 0.0, 0.0, 0.0, 0.0
            quadratic[fixed, fixed] = diagonal
        lower, upper = np.zeros(size), np.full(size, np.inf)
        down, up = (each / self._scale for each in linear.room)
        lower[:m], upper[:m] = np.maximum(down, -REACH), np.minimum(up, REACH)
        x, prices = solve_quadratic(
            quadratic * unit[:, np.newaxis] * unit, cost * unit, matrix * unit, np.concatenate(right), lower, upper
        )
        x = unit * x
        parts = np.split(prices, np.cumsum([*map(len, near), len(linear.loads)]))
        of_rows = [np.zeros(len(rows.deciding)) for rows in linear.rows]
        for each, rows, some, found in zip(of_rows, linear.rows, near, parts, strict=False):
            each[np.flatnonzero(rows.deciding)[some]] = found
        self._prices = of_rows, parts[len(near)]
        return x[:m], float(cost @ x) + 0.5 * float(x[:m] @ linear.curvature @ x[:m])

    def improvements(self, start: Motions, iterations: int, penalty: float = PENALTY[0]) -> Iterator[State]:
        """Better and better motions, from the start on.

        Args:
            start: the first motions.
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
                motions = found.motions
                # derivatives are large
                del state, linear, found
                state = self.state(motions)
                linear = self.linear(state)
                yield state
            penalty *= 4.0 if ratio < 0.1 else 2.0 if ratio < 0.4 else 0.4 if ratio > 0.8 else 1.0
            self.penalty = penalty
            if penalty > PENALTY[1]:
                return

    def _after_step(self, state: State, linear: Linear, step: RealArray, penalty: float, fall: float) -> State:
        """The motions after a step, or after its second-order correction if that is better; the old ones where there are none."""
        try:
            found = self.state(self._moved(state.motions, step), derivatives=False)
            last = found
            for _ in range(CORRECTIONS):
                if (self.merit(state) - self.merit(found)) / fall > 0.9:
                    break
                step = self.step(self.corrected(linear, step, last), penalty)[0]
                last = self.state(self._moved(state.motions, step), derivatives=False)
                found = min(found, last, key=self.merit)
        except (EquilibriumError, TrajectoryError):
            return state
        return found

    def _moved(self, motions: Motions, step: RealArray) -> Motions:
        """The motions after a step of the variables."""
        return tuple(motion.moved(step[way.columns]) for way, motion in zip(self.ways, motions, strict=True))

    @staticmethod
    def _diagonal(blocks: Sequence[RealArray]) -> RealArray:
        """The matrix that has the ways' own ones on its diagonal."""
        return blocks[0] if len(blocks) == 1 else np.asarray(block_diag(*blocks))


LOOSE, FALL = 2e-5, 12.0
"""Bound of the residual vibration [m] in the first stages, and about how much it falls from each to the next."""

NODES = 9
"""Number of variants that the programmes have: 7 payloads within 30 % leave 1 µm of residual vibration between them."""

CHECKED = np.array([3e-4, 1e-4, 1e-4, 1e-4, 1.5e-2, 6e-4, *[3e-4] * (len(GROUPS) - 6)])
"""Violations, in the order of `GROUPS`, up to which the limits count as met on the fine grid: 15 µm, and 3 % of the residual."""

ROUNDS = 8
"""Largest number of evaluations of all variants on the fine grid."""

JOINING, TIGHTER = 0.8, 1.04
"""Share of the allowed residual vibration from which on a variant between others joins them, and by how much its bound falls in a round, at
most: those that join lower it too."""

SCALED, NO_VIBRATION = (0.4, 1.5), 1e-12
"""Largest changes of a bound by which it becomes the displacement that it bounds, and displacement [m] that is none."""

PHASE, FINER = 2.5, 2
"""Phase [rad] of the faster of the two lowest modes of the lightest robot in a step of the coarse grid, at most, and how much finer the other grid is."""


@dataclass(frozen=True, eq=False)
class Improvement:
    """Motions on the way to the best ones.

    Attributes:
        motions: the joint references of each way.
        violations: largest relative violation of each of `GROUPS` among the variants that were considered; 0 where it is met.
        residual: bound of the displacement of the end effector by vibration after a way, of these variants [m].
        checked: whether all variants meet all limits on the fine grid.
    """

    motions: Motions
    violations: Mapping[str, float]
    residual: float
    checked: bool


def optimal_motion(
    ways: Sequence[Way],
    loads: Mapping[str, RealArray] | None = None,
    nodes: Sequence[int] | None = None,
    *,
    iterations: int = 40,
    loose: float = LOOSE,
    aim: Aim = "time",
) -> Iterator[Improvement]:
    """Joint references that are better and better within limits that hold for all robots.

    Args:
        ways: the motion, or the ways of a cycle, each of which starts where the one before ends.
        loads: limits of ``rms_torque`` (C, 2) [N m] and ``energy`` (C,) [J] of all ways with the pauses after them, for each case.
        nodes: indices of the cases that the programmes have; None for `NODES` that are denser near both ends.
        iterations: largest number of programmes in each stage.
        loose: bound of the residual vibration [m] in the first stages; the last bound is the least. Without a larger one the first
            motions are taken to be near the best ones.
        aim: what is minimised; all but time in the durations of the first motions.

    Yields:
        Motions on the way; the last ones with ``checked`` are the best that meet all limits.

    Raises:
        EquilibriumError: the first motions have no elastic motion.
    """
    count, limit, loads = len(ways[0].cases), ways[0].limits.residual, loads or {}
    chosen = np.array(spread(count, NODES) if nodes is None else nodes)
    motions, loose, parts = tuple(way.start for way in ways), max(limit, loose), max(map(_parts, ways))

    def stage_of(chosen: NDArray[np.intp], residual: float, excess: Mapping[str, float], parts: int) -> Stage:
        some = [
            replace(way, start=motion, limits=replace(way.limits, residual=residual).tightened(excess)).of_cases(chosen)
            for way, motion in zip(ways, motions, strict=True)
        ]
        tight = {name: each[chosen] / excess.get(name, 1.0) for name, each in loads.items()}
        return Stage(some, tight, parts, [way.start.duration for way in ways], aim)

    # few variants, then all nodes, with a bound that falls
    levels = max(1, round(math.log(loose / limit, FALL)))
    bounds = np.geomspace(loose, limit, levels + 1)[:-1].tolist()
    stages = [(chosen[spread(len(chosen), 3)], loose), *((chosen, bound) for bound in bounds)]
    if loose == limit:
        # the first motion is near the best one
        stages = []
    penalty = PENALTY[0]
    for few, residual in stages:
        stage = stage_of(few, residual, {}, parts)
        for found in map(_improvement, stage.improvements(motions, iterations, penalty)):
            motions = found.motions
            yield found
        penalty = max(PENALTY[0], min(4.0 * stage.penalty, 10.0))
    # all variants on the fine grid
    fine, excess = stage_of(np.arange(count), limit, {}, FINER * parts), dict[str, float]()
    exact = fine.scaled(fine.state(motions, derivatives=False, renewed=True))
    for _ in range(ROUNDS):
        # the worst variants join the nodes
        residuals = np.max([_sizes(each) for each in exact.amplitudes], axis=0)
        around = np.pad(residuals, 1)
        is_worst = (residuals >= np.maximum(around[:-2], around[2:])) & (residuals > JOINING * limit)
        chosen = np.unique([*chosen, *np.flatnonzero(is_worst)])
        stage = stage_of(chosen, limit, excess, parts)
        coarse = stage.state(motions, derivatives=False, renewed=True)
        for way, each, fine_way, there, here in zip(
            ways, stage.ways, fine.ways, exact.responses, coarse.responses, strict=True
        ):
            robots = np.unique(way.cases[chosen])
            each.vibration.error = there.end[robots] - here.end
            each.vibration.matrices = fine_way.vibration.matrices[robots]
        for found in map(_improvement, stage.improvements(motions, iterations, penalty)):
            motions = found.motions
            yield found
        exact = fine.scaled(fine.state(motions, derivatives=False, renewed=True))
        met = bool((exact.violations <= CHECKED).all())
        yield replace(_improvement(exact), checked=met)
        if met:
            return
        # what else lies between them tightens the limits
        missed = {name for name, is_missed in zip(GROUPS, exact.violations > CHECKED, strict=True) if is_missed}
        beyond, worst = {"residual": min(_residual(exact) / limit, TIGHTER)}, list[int]()
        if "clearance" in missed:
            # also between instants of the coarse grid
            excess["clearance"] = excess.get("clearance", 0.0) + DEPTH * float(exact.violations[CLEARANCE])
        # each load of every way, by case
        sizes = [(name, each) for name, each in exact.loads.items()]
        for k, (way, of_way) in enumerate(zip(ways, fine.ways, strict=True)):
            found = of_way.rows.loads(exact.motions[k], exact.responses[k])
            sizes += [(name, np.abs(each)[way.cases]) for name, each in found.items()]
        for name, size in sizes:
            if name in missed:
                beyond[name] = max(beyond.get(name, 0.0), float(size.max()) / 0.9998)
                worst.append(int(np.unravel_index(size.argmax(), size.shape)[0]))
        excess |= {name: excess.get(name, 1.0) * factor for name, factor in beyond.items() if name in missed}
        chosen = np.unique([*chosen, *worst])


def _parts(way: Way) -> int:
    """Steps of the integration for each interval of a way's splines, at least two."""
    robot, motion = way.robots[0], way.start
    rest = VariantModel(robot.scene, [robot.changes], robot.evaluate).rest(motion.evaluate(0.0, 0)[0, 0])
    highest = float(free_modes(rest).frequencies[:, :2].max(initial=0.0))
    return max(2, math.ceil(highest * motion.duration / motion.intervals / PHASE))


def spread(count: int, number: int) -> list[int]:
    """Indices of a number of things in a row of a count, denser near both ends (Chebyshev's nodes)."""
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(number) + 0.5) / number) / np.cos(0.5 * np.pi / number)
    return sorted({int(k) for k in np.rint(nodes * (count - 1))}) if number > 1 else [(count - 1) // 2]


def _residual(state: State) -> float:
    return max(float(_sizes(each).max(initial=0.0)) for each in state.amplitudes)


def _improvement(state: State) -> Improvement:
    violations = dict(zip(GROUPS, state.violations.tolist(), strict=True))
    return Improvement(state.motions, violations, _residual(state), checked=False)

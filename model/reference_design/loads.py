"""What motors, their supply, joints and links have to do for a motion of P robots, with derivatives by the m variables of its design.

A load at an instant is a function of torques, speeds and accelerations of the joints (`motor_load`), or an output of the response. What a
motion adds to a load of a whole cycle is the integral of a convex function of a load (`OF_CYCLE`). Curvatures take torques and
speeds as linear in the variables (Gauss-Newton): squares of torques, and products of torques and speeds are curved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flexfmu.model.reference_design.elastic_response import LINK_LOADS, METHOD, Response
from flexfmu.model.scene.motor import Motor
from flexfmu.trajectories.jets import RealArray

Convex = Callable[[RealArray], tuple[RealArray, RealArray, RealArray]]
"""A convex function, with its first and second derivatives."""


def power(k: int) -> Convex:
    """The k-th power, for an even k."""
    return lambda y: (y**k, k * y ** (k - 1), k * (k - 1) * y ** (k - 2))


def positive(y: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """The positive part."""
    is_positive = np.asarray(y > 0.0, dtype=float)
    return is_positive * y, is_positive, np.zeros_like(y)


OF_CYCLE: Mapping[str, tuple[str, Convex]] = {
    "rms_torque": ("torque", power(2)),
    "motor_rms_torque": ("shaft_torque", power(2)),
    "energy": ("power", positive),
    "regenerated_energy": ("regenerated_power", positive),
}
"""Loads of the whole cycle, not of an instant → the load and its function whose integrals its ways add."""

ROOTS = ("rms_torque", "motor_rms_torque")
"""Those that are roots of means over its time, and of each joint."""


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

    def torque(self, torque: RealArray, speed: RealArray, acceleration: RealArray) -> tuple[RealArray, ...]:
        """Torques of the shafts (P, N, 2) [N m], and their derivatives by torque and acceleration of the joints.

        Args:
            torque: of the joints (P, N, 2) [N m].
            speed, acceleration: of the joints (N, 2) [rad/s, rad/s²].
        """
        ratio, efficiency, rotor = (
            np.array([getattr(motor, name) for motor in self.motors])
            for name in ("gear_ratio", "gear_efficiency", "rotor_inertia")
        )
        load = torque - self.inertia * acceleration
        factor = efficiency ** -np.sign(load * speed) / ratio
        return factor * load + rotor * ratio * acceleration, factor, rotor * ratio - self.inertia * factor

    def largest(self, speed: RealArray) -> tuple[RealArray, RealArray]:
        """The largest torques of the shafts (N, 2) [N m] at speeds of the joints (N, 2) [rad/s], and their derivatives by the speeds."""
        pairs = [each.largest_torque(each.gear_ratio * v) for each, v in zip(self.motors, speed.T, strict=True)]
        torque, slope = (np.stack(each, axis=-1) for each in zip(*pairs, strict=True))
        return torque, slope * [each.gear_ratio for each in self.motors]


def weight_of_squares(name: str, period: float, drives: Drives | None) -> tuple[RealArray, RealArray]:
    """What an integral of squares counts for one of `ROOTS` in a cycle, of both joints (2,) [1/s], and its derivative by the period [s]."""
    if name == "rms_torque" or drives is None:
        return np.full(2, 1.0 / period), np.full(2, -1.0 / period**2)
    weight, slope = zip(*(each.heating(period) for each in drives.motors), strict=True)
    return np.array(weight), np.array(slope)


@dataclass(frozen=True, eq=False)
class InstantLoad:
    """A load at N instants.

    Attributes:
        value: of each joint (P, N, 2), or of both together (P, N, 1).
        by: derivatives by torque, speed and acceleration of each joint (3, P, N, 2).
        product: second derivatives by torque and speed of each joint, of a shape like (P, N, 2).
    """

    value: RealArray
    by: RealArray
    product: RealArray


def motor_load(
    name: str, torque: RealArray, speed: RealArray, acceleration: RealArray, drives: Drives | None = None
) -> InstantLoad:
    """A load of the motors or their supply.

    These are ``torque`` [N m] and ``power`` [W] of both motors, positive into the robot; ``supply_power`` and ``regenerated_power`` [W] of
    both together, zero where the other one flows; ``motor_torque`` of the shafts relative to the largest at their speeds, and
    ``shaft_torque`` relative to the torque that they can hold for ever.

    Args:
        name: which one.
        torque: of the joints (P, N, 2) [N m].
        speed, acceleration: of the joints (N, 2) [rad/s, rad/s²].
        drives: the motors, for the loads of shafts.
    """
    if name == "torque":
        return InstantLoad(torque, np.multiply.outer([1.0, 0.0, 0.0], np.ones_like(torque)), np.zeros(1))
    if name in ("motor_torque", "shaft_torque"):
        assert drives is not None
        shaft, by_torque, by_acceleration = drives.torque(torque, speed, acceleration)
        largest, slope = np.array([each.continuous_torque for each in drives.motors]), np.zeros(2)
        if name == "motor_torque":
            largest, slope = drives.largest(speed)
        by = [by_torque, -shaft * slope / largest, by_acceleration]
        return InstantLoad(shaft / largest, np.array(by) / largest, np.zeros(1))
    flow = torque * speed
    both = flow.sum(axis=2, keepdims=True)
    # what counts of the powers
    signs = {"power": np.ones(1), "supply_power": (both > 0.0) * 1.0, "regenerated_power": (both < 0.0) * -1.0}
    sign = signs[name]
    by = [sign * speed + 0.0 * torque, sign * torque, np.zeros_like(torque)]
    return InstantLoad(flow if name == "power" else sign * both, np.array(by), sign)


class Loads:
    """The loads of a motion.

    Args:
        response: the robots' response to it.
        holding: torques at rest after the motion (P, 2) [N m].
        pause: time at rest after the motion [s].
        drives: the motors, for the loads of shafts.
        links: names of `LINK_LOADS` that the response has.
    """

    def __init__(
        self,
        response: Response,
        holding: RealArray | float = 0.0,
        pause: float = 0.0,
        drives: Drives | None = None,
        links: tuple[str, ...] = (),
    ) -> None:
        self.response, self._holding, self._pause, self._drives = response, holding, pause, drives
        steps = response.torque.shape[1] // 3
        # of all instants in integrals over the motion (N, 1) [s]
        self._weights = response.duration / steps * np.tile(METHOD.whole, steps)[:, np.newaxis]
        edges = np.cumsum([0, *(LINK_LOADS[name][0] for name in links)]).tolist()
        self._places = {name: slice(*each) for name, each in zip(links, pairwise(edges), strict=True)}
        self._known = dict[str, InstantLoad]()

    def values(self, name: str) -> RealArray:
        """The load at all instants (P, N, r): of both joints, of both together, or of places; see `motor_load` and `LINK_LOADS`."""
        return self.response.loads[..., self._places[name]] if name in self._places else self._load(name).value

    def of_cycle(self, name: str) -> RealArray:
        """What motion and pause add to a load of the cycle, of both joints (P, 2) for one of `ROOTS`, else (P, 1)."""
        return self.integral(*OF_CYCLE[name], self._pause)

    def need(self, name: str, instants: int | None = None) -> RealArray:
        """The largest magnitude of a load at the first instants, or what is added to one of the cycle: of both joints (P, 2), or (P,)."""
        found = self.of_cycle(name) if name in OF_CYCLE else np.abs(self.values(name)[:, :instants]).max(axis=1)
        return found if found.shape[1] == 2 else found.max(axis=1)

    def integral(self, name: str, convex: Convex, pause: float = 0.0) -> RealArray:
        """Integral over the motion, and a time at rest after it [s], of a function of a load of the motors, of each (P, 2); of powers
        that of both together (P, 1)."""
        still, torque = np.zeros((1, 2)), np.broadcast_to(self._holding, (len(self.response.torque), 2))
        at_rest = motor_load(name, torque[:, np.newaxis], still, still, self._drives).value[:, 0]
        found = (self._weights * convex(self._load(name).value)[0]).sum(axis=1) + pause * convex(at_rest)[0]
        return np.asarray(found.sum(axis=1, keepdims=True) if name.endswith("power") else found)

    def rows(self, name: str, some: NDArray[np.bool_]) -> RealArray:
        """Derivatives (R, m) of some values, those that a mask (P, N, r) selects."""
        if name in self._places:
            return np.asarray(self.response.loads_by[:, :, self._places[name]][some])
        load, (p, n, j) = self._load(name), np.nonzero(some)
        found = np.zeros((len(p), self.response.torque_by.shape[-1]))
        for k in (j,) if load.value.shape[2] == 2 else (0, 1):
            for by, changes in zip(load.by, self._changes, strict=True):
                if by.any():
                    part = changes[p, n, k]
                    part *= by[p, n, k][:, np.newaxis]
                    found += part
        return found

    def integral_by(self, name: str, convex: Convex) -> RealArray:
        """Derivatives (P, 2, m) or (P, 1, m) of an integral, whatever the pause."""
        load, found = self._load(name), np.zeros((len(self.response.torque), *self.response.torque_by.shape[2:]))
        weights = self._weights * convex(load.value)[1]
        for by, changes in zip(load.by, self._changes, strict=True):
            if by.any():
                found += np.einsum("pnj,pnjm->pjm", weights * by, changes)
        if name.endswith("power"):
            found = found.sum(axis=1, keepdims=True)
        # the last variable is the duration
        found[..., -1] += self.integral(name, convex) / self.response.duration
        return found

    def curvature(self, name: str, prices: RealArray) -> RealArray:
        """The curvature (m, m) of a load at all instants, each at a price (P, N, r)."""
        m = self.response.torque_by.shape[-1]
        if name in self._places:
            return np.zeros((m, m))
        products = prices * self._load(name).product
        p, n, j = np.nonzero(products)
        torque_by, speed_by, _ = self._changes
        found = (products[p, n, j, np.newaxis] * torque_by[p, n, j]).T @ speed_by[p, n, j]
        return np.asarray(found + found.T)

    def integral_curvature(self, name: str, convex: Convex, prices: RealArray) -> RealArray:
        """The curvature (m, m) of the integral of a function of a load, each at a price (P, r)."""
        _, slope, curvature = convex(self._load(name).value)
        weights = self._weights * prices[:, np.newaxis]
        squares = weights * curvature
        rows = self.rows(name, squares > 0.0)
        rows *= np.sqrt(squares[squares > 0.0])[:, np.newaxis]
        return np.asarray(self.curvature(name, weights * slope) + rows.T @ rows)

    def _load(self, name: str) -> InstantLoad:
        if name not in self._known:
            _, speed, acceleration = self.response.references
            self._known[name] = motor_load(name, self.response.torque, speed, acceleration, self._drives)
        return self._known[name]

    @cached_property
    def _changes(self) -> tuple[RealArray, ...]:
        """Derivatives of torque, speed and acceleration of the joints (P, N, 2, m)."""
        by, shape = self.response.references_by, self.response.torque_by.shape
        return self.response.torque_by, *(np.broadcast_to(by[:, k : k + 2], shape) for k in (2, 4))

"""Symbols of the robot in redundant coordinates: floating frames, elastic coordinates and end effector.

A link j of leg i has the base point P (fixed for a proximal link), the direction e = (cos theta, sin theta) with the
normal n = (-sin theta, cos theta), and the displacement u = (u_x along e, u_y along n) of eq. (5) of Barnard, Briot and
Caro (2012). The direction is a unit vector, not an angle: the closed-form assembly gives it without atan2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi
import numpy as np

from flexfmu.model.beams import Direction, LinkGroup, Shape, ShapeIntegrals, integrate_shapes

LEGS = (1, 2)
LINK_ORDER: tuple[tuple[str, LinkGroup, int], ...] = (
    ("link11", "proximal", 1),
    ("link12", "distal", 1),
    ("link21", "proximal", 2),
    ("link22", "distal", 2),
)
"""Links in the order of the paper's q_e = [q_e11, q_e12, q_e21, q_e22]."""


@dataclass(frozen=True)
class Family:
    """The modes of one direction on one link group; both legs share the derived values.

    Attributes:
        group: links that have these modes.
        direction: axial (u_x) or bending (u_y).
        shapes: mode shapes, K of them.
        stiffness: modal stiffness matrix K (K, K) [N/m].
        mass: modal mass matrix of the link alone (K, K) [kg].
        compliance: inverse of the stiffness (K, K) [m/N] if the modes deflect statically; None if they are states.
    """

    group: LinkGroup
    direction: Direction
    shapes: tuple[Shape, ...]
    stiffness: casadi.SX
    mass: casadi.SX
    compliance: casadi.SX | None = None

    @property
    def quasi_static(self) -> bool:
        """Whether the modes deflect statically instead of being states."""
        return self.compliance is not None

    @property
    def tips(self) -> casadi.DM:
        """Tip displacements phi_k(1), shape (K, 1)."""
        return casadi.DM([shape.tip for shape in self.shapes])


@dataclass(frozen=True)
class ElasticSymbols:
    """The coordinates of one family on one link: q [m] and their rates v [m/s], shape (K, 1)."""

    family: Family
    q: casadi.SX
    v: casadi.SX


@dataclass(frozen=True)
class Shortening:
    """By how much bending shortens a link at its tip, as functions of the bending coordinates q and rates v (K, 1).

    Attributes:
        amount: q → s [m].
        gradient: q → derivative of s by q (K, 1).
        curvature: (q, v) → second time derivative of s without accelerations [m/s²].
    """

    amount: Callable[[casadi.SX], casadi.SX]
    gradient: Callable[[casadi.SX], casadi.SX]
    curvature: Callable[[casadi.SX, casadi.SX], casadi.SX]


@dataclass(frozen=True)
class Link:
    """Symbols of one link; the base velocity is the number zero where the base point is fixed."""

    name: str
    group: LinkGroup
    leg: int
    direction: casadi.SX
    turning_rate: casadi.SX
    base: casadi.SX
    base_velocity: casadi.SX
    elastic: tuple[ElasticSymbols, ...]

    @property
    def normal(self) -> casadi.SX:
        """Normal n, shape (2, 1)."""
        return casadi.vertcat(-self.direction[1], self.direction[0])

    def family(self, direction: Direction) -> ElasticSymbols | None:
        """The coordinates of one direction, None where it is rigid."""
        return next((part for part in self.elastic if part.family.direction == direction), None)

    def shape_integrals(self) -> ShapeIntegrals:
        """Integrals over all shapes of the link, axial ones first, then bending."""
        parts = sorted(self.elastic, key=lambda part: part.family.direction)
        return integrate_shapes([shape for part in parts for shape in part.family.shapes])


@dataclass(frozen=True)
class Robot:
    """All symbols of the redundant formulation.

    The rates are ordered [w11, w21, w12, w22, P1' (2), P2' (2), X' (2), q_e' (n)]: proximal, passive, elastic. With
    elastic transmissions the last two elastic coordinates are the twists of the joints [rad], link minus motor angle.

    Attributes:
        links: by name, in the order of q_e.
        position, velocity: of the end effector, (2, 1) [m, m/s].
        twist, twist_rate: (2, 1) [rad, rad/s], or empty where the transmissions are rigid.
        shortening: of link groups that bending makes shorter.
    """

    links: Mapping[str, Link]
    position: casadi.SX
    velocity: casadi.SX
    twist: casadi.SX
    twist_rate: casadi.SX
    shortening: Mapping[LinkGroup, Shortening]

    @property
    def motor_rates(self) -> tuple[casadi.SX, casadi.SX]:
        """Angular rates of the motors [rad/s]."""
        rates = [self.links[f"link{leg}1"].turning_rate for leg in LEGS]
        if self.twist.numel():
            rates = [rate - self.twist_rate[i] for i, rate in enumerate(rates)]
        return rates[0], rates[1]

    @property
    def twist_selection(self) -> casadi.DM:
        """Matrix (n, 2) with twist = selection' q_e; without entries where the transmissions are rigid."""
        n = self.q_e.numel()
        selection = casadi.DM(n, 2)
        for i in range(self.twist.numel()):
            selection[n - 2 + i, i] = 1.0
        return selection

    @property
    def elastic(self) -> tuple[tuple[Link, ElasticSymbols], ...]:
        """Links and families in the order of q_e."""
        return tuple((link, part) for link in self.links.values() for part in link.elastic)

    @property
    def q_e(self) -> casadi.SX:
        """Elastic coordinates, shape (n, 1)."""
        return casadi.vertcat(casadi.SX(0, 1), *(part.q for _, part in self.elastic), self.twist)

    @property
    def v_e(self) -> casadi.SX:
        """Elastic rates, shape (n, 1)."""
        return casadi.vertcat(casadi.SX(0, 1), *(part.v for _, part in self.elastic), self.twist_rate)

    @property
    def elastic_names(self) -> tuple[str, ...]:
        """Names of the elastic coordinates, like ``link11.bending[1]``."""
        modes = tuple(
            f"{link.name}.{part.family.direction}[{k + 1}]"
            for link, part in self.elastic
            for k in range(len(part.family.shapes))
        )
        return modes + tuple(f"joint{leg}.twist" for leg in LEGS[: self.twist.numel()])

    @property
    def elastic_texts(self) -> tuple[str, ...]:
        """Descriptions of the elastic coordinates."""
        modes = tuple(
            f"{part.family.direction.capitalize()} coordinate {k + 1} of {link.group} link {link.leg} ({link.name}): {shape.text}"
            for link, part in self.elastic
            for k, shape in enumerate(part.family.shapes)
        )
        return modes + ("Twist of the transmission, link minus motor",) * self.twist.numel()

    @property
    def elastic_units(self) -> tuple[str, ...]:
        """Units of the elastic coordinates."""
        twists = self.twist.numel()
        return ("m",) * (self.q_e.numel() - twists) + ("rad",) * twists


def make_robot(
    families: Sequence[Family],
    base_half_distance: casadi.SX,
    elastic_joints: bool,
    shortening: Mapping[LinkGroup, Shortening],
) -> Robot:
    """Symbols of a robot with these families, and with twists of the transmissions if `elastic_joints`."""
    twists = 2 if elastic_joints else 0
    bases = {1: casadi.vertcat(-base_half_distance, 0.0), 2: casadi.vertcat(base_half_distance, 0.0)}
    links = {name: _make_link(name, group, leg, bases[leg], families) for name, group, leg in LINK_ORDER}
    twist, twist_rate = casadi.SX.sym("twist", twists), casadi.SX.sym("twist_rate", twists)
    return Robot(links, casadi.SX.sym("X", 2), casadi.SX.sym("Xd", 2), twist, twist_rate, shortening)


def _make_link(name: str, group: LinkGroup, leg: int, base: casadi.SX, families: Sequence[Family]) -> Link:
    # the base point of a proximal link is fixed
    moves = group == "distal"
    # symbols of its elastic families
    elastic = tuple(
        ElasticSymbols(
            family, casadi.SX.sym(f"q_{name}", len(family.shapes)), casadi.SX.sym(f"v_{name}", len(family.shapes))
        )
        for family in families
        if family.group == group
    )
    return Link(
        name=name,
        group=group,
        leg=leg,
        direction=casadi.SX.sym(f"e_{name}", 2),
        turning_rate=casadi.SX.sym(f"w_{name}"),
        base=casadi.SX.sym(f"P{leg}", 2) if moves else base,
        base_velocity=casadi.SX.sym(f"Pd{leg}", 2) if moves else casadi.SX(np.zeros((2, 1))),
        elastic=elastic,
    )


class TipMap:
    """Tip displacements as functions of the elastic coordinates: linear terms minus the shortening by bending."""

    def __init__(self, robot: Robot) -> None:
        self._gains: dict[tuple[str, Direction], casadi.DM] = {}
        self._shortening: dict[str, tuple[slice, Shortening]] = {}
        # slice of the elastic coordinates of each family
        n = robot.q_e.numel()
        start = 0
        for link, part in robot.elastic:
            stop = start + part.q.numel()
            gain = casadi.DM.zeros(n, 1)
            gain[start:stop] = part.family.tips
            self._gains[link.name, part.family.direction] = casadi.sparsify(gain)
            # bending also shortens the link where the scene has foreshortening
            if part.family.direction == "bending" and link.group in robot.shortening:
                self._shortening[link.name] = slice(start, stop), robot.shortening[link.group]
            start = stop
        self._none = casadi.DM(n, 1)
        self.twist = robot.twist_selection

    def gain(self, link: str, direction: Direction, q_e: casadi.SX) -> casadi.DM | casadi.SX:
        """Gradient (n, 1) of the tip displacement by q_e: phi(1) of the link's family, minus that of the shortening."""
        linear = self._gains.get((link, direction), self._none)
        if direction != "axial" or link not in self._shortening:
            return linear
        rows, by_bending = self._shortening[link]
        slope = by_bending.gradient(q_e[rows])
        return linear - casadi.vertcat(casadi.SX(rows.start, 1), slope, casadi.SX(q_e.numel() - rows.stop, 1))

    def displacement(self, link: str, direction: Direction, q_e: casadi.SX) -> casadi.SX:
        """Tip displacement u(1) [m]."""
        linear = self._product(self._gains.get((link, direction), self._none), q_e)
        if direction != "axial" or link not in self._shortening:
            return linear
        rows, by_bending = self._shortening[link]
        return linear - by_bending.amount(q_e[rows])

    def rate(self, link: str, direction: Direction, q_e: casadi.SX, v_e: casadi.SX) -> casadi.SX:
        """Rate of the tip displacement [m/s]."""
        return self._product(self.gain(link, direction, q_e), v_e)

    def acceleration(
        self, link: str, direction: Direction, q_e: casadi.SX, v_e: casadi.SX, a_e: casadi.SX
    ) -> casadi.SX:
        """Second time derivative of the tip displacement [m/s²]."""
        linear = self._product(self.gain(link, direction, q_e), a_e)
        if direction != "axial" or link not in self._shortening:
            return linear
        rows, by_bending = self._shortening[link]
        return linear - by_bending.curvature(q_e[rows], v_e[rows])

    def _product(self, gain: casadi.DM | casadi.SX, coordinates: casadi.SX) -> casadi.SX:
        return casadi.dot(gain, coordinates) if coordinates.numel() else casadi.SX(0)

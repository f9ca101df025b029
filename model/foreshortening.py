"""Foreshortening: bending moves the tip of a link towards its base, which couples bending with axial forces.

The axial displacement gets the second-order term -1/(2 l) ∫ phi_j' phi_k' q_j q_k over 0..xi. The kinetic energy
contains it in all terms of second order in q: they stiffen a rotating link (centrifugal stiffening), and stiffen or
soften it under acceleration of its base. At the tip it shortens the link in the assembly: payload, gravity and the
other links then stiffen or buckle it, and the end-effector position is that of bent links of constant length.

Sources: Kane, Ryan and Banerjee, Dynamics of a cantilever beam attached to a moving base, J. Guidance 10 (1987);
Wallrapp and Schwertassek, Representation of geometric stiffening in multibody system simulation, Int. J. Numer. Methods
Eng. 32 (1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import casadi
import numpy as np

from flexfmu.model.beams import Evaluate, LinkGroup, gram
from flexfmu.model.effects import Effect, EffectContext, form, symmetric
from flexfmu.model.parameters import LinkProperties, ParameterRegistry
from flexfmu.model.robot import ElasticSymbols, Family, Link, Robot
from flexfmu.model.scene.mechanism import LinkSection as Rod
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import EffectNote


class Foreshortening(Effect):
    """Second-order shortening of bending links: geometric stiffening by rotation, payload, gravity and joint forces."""

    note = EffectNote(
        title="foreshortening",
        sentence="Second-order shortening of links that bend: geometric stiffening by rotation, payload, gravity and joint forces.",
        formula="u = −1/(2l) ∑ ∫ φ_j′ φ_k′ dξ q_j q_k",
        contributes=("shortening of links", "kinetic energy T", "weight"),
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        chosen = context.scene.effects
        if chosen.foreshortening and (chosen.proximal_bending or chosen.distal_bending):
            yield cls(context.registry, context.links)

    def __init__(self, registry: ParameterRegistry, properties: Mapping[LinkGroup, LinkProperties]) -> None:
        self._registry, self._properties = registry, properties

    def shortening(self, family: Family) -> casadi.SX | None:
        if family.direction != "bending":
            return None
        return self._matrix(family, "shortening", np.ones_like, 1.0 / self._properties[family.group].length)

    def first_moment(self, robot: Robot) -> casadi.SX:
        parts = (self._shift(part, part.q) * link.direction for link, part in _bending(robot))
        return sum(parts, casadi.SX(np.zeros((2, 1))))

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """V · d/dt (∫ u dm e) + w² ∫ x u dm, summed over the links, with the axial displacement u due to bending."""
        total = casadi.SX(0)
        for link, part in _bending(robot):
            w, mass = link.turning_rate, self._properties[part.family.group].mass
            rate = 2 * self._shift(part, part.v) * link.direction + w * self._shift(part, part.q) * link.normal
            centrifugal = self._matrix(part.family, "centrifugal", lambda xi: 1.0 - xi**2, mass / 2)
            total += casadi.dot(link.base_velocity, rate) - 0.5 * w**2 * form(centrifugal, part.q, part.q)
        return total

    def _shift(self, part: ElasticSymbols, other: casadi.SX) -> casadi.SX:
        """-1/2 other' G q, where ∫ u dm = -1/2 q' G q [kg m]."""
        properties = self._properties[part.family.group]
        matrix = self._matrix(part.family, "shift", lambda xi: 1.0 - xi, properties.mass / properties.length)
        return -0.5 * form(matrix, other, part.q)

    def _matrix(self, family: Family, name: str, weight: Evaluate, factor: casadi.SX) -> casadi.SX:
        products = gram(family.shapes, lambda shape: shape.slope, weight)
        prefix = f"{family.group}_{name}"
        return symmetric(
            len(family.shapes),
            lambda i, j: self._registry.derived(f"{prefix}_{i}_{j}", factor * products[i, j]),
            products,
        )


def bending_beyond(robot: Robot, scene: Scene) -> casadi.SX:
    """Bending energy of fourth order, which the model neglects: 1/2 ∫ EI w''² w'² dx [J].

    The curvature of an inextensible line is w'' / sqrt(1 - w'²). The other terms of this order (inertia of the
    shortening, w'⁴ / 8) are far smaller, see ``tests/cosim/metrics/test_large_deflections.py``.

    Source: Crespo da Silva and Glynn, Nonlinear flexural-flexural-torsional dynamics of inextensional beams, J. Struct.
    Mech. 6 (1978), eq. (14) in the plane.
    """
    # slopes and strains at the quadrature nodes, as functions of the elastic coordinates
    xi, weights = np.polynomial.legendre.leggauss(40)
    energy = casadi.SX(0)
    for link, part in _bending(robot):
        geometry: Rod = getattr(scene.mechanism, link.group)
        second = np.pi / 64.0 * (geometry.diameter**4 - geometry.inner_diameter**4)
        slopes, strains = (
            casadi.DM(np.stack([field(0.5 * (xi + 1.0)) for field in fields], axis=1)) @ part.q
            for fields in zip(*((shape.slope, shape.strain) for shape in part.family.shapes), strict=True)
        )
        rigidity = scene.mechanism.material.youngs_modulus * second / geometry.length**5
        energy += 0.5 * rigidity * casadi.dot(casadi.DM(0.5 * weights), (slopes * strains) ** 2)
    return energy


def _bending(robot: Robot) -> Iterator[tuple[Link, ElasticSymbols]]:
    return ((link, part) for link, part in robot.elastic if part.family.direction == "bending")

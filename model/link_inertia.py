"""Inertia of the links; each beam deforms in a floating frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import casadi
import numpy as np

from flexfmu.model.beams import LinkGroup
from flexfmu.model.effects import Effect, EffectContext, column, dot, form, symmetric
from flexfmu.model.parameters import LinkProperties, ParameterRegistry
from flexfmu.model.robot import Link, Robot
from flexfmu.model.symbolic import EffectNote


class LinkInertia(Effect):
    """Inertia of the four links with their displacement fields, eqs. (4) to (9) of Barnard, Briot and Caro (2012)."""

    note = EffectNote(
        title="link inertia",
        sentence="Inertia of the four links with their displacement fields, eqs. (4) to (9) of Barnard, Briot and Caro (2012).",
        formula="T = ½ ∑ ∫ |Ẋ|² dm, X = B + (x + u) e + w n, u and w the elastic displacements",
        contributes=("kinetic energy T", "weight"),
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        yield cls(context.registry, context.links)

    def __init__(self, registry: ParameterRegistry, properties: Mapping[LinkGroup, LinkProperties]) -> None:
        self._registry, self._properties = registry, properties

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """Kinetic energy of all links: the base point P translates, the frame rotates, the beam deforms in it."""
        total = casadi.SX(0)
        for link in robot.links.values():
            integrals, w, V = self._integrals(link), link.turning_rate, link.base_velocity
            # motion of the base point, and its product with the motion relative to it
            along, across = integrals.moment(link)
            along_rate, across_rate = integrals.moment_rate(link)
            relative = (along_rate - w * across) * link.direction + (across_rate + w * along) * link.normal
            translation = 0.5 * integrals.mass * casadi.dot(V, V) + casadi.dot(V, relative)
            total += translation + integrals.relative_energy(link, w)
        return total

    def first_moment(self, robot: Robot) -> casadi.SX:
        total = casadi.SX(np.zeros((2, 1)))
        for link in robot.links.values():
            integrals = self._integrals(link)
            along, across = integrals.moment(link)
            total += integrals.mass * link.base + along * link.direction + across * link.normal
        return total

    def _integrals(self, link: Link) -> _LinkIntegrals:
        return _LinkIntegrals(self._registry, link, self._properties[link.group])


class _LinkIntegrals:
    """Mass integrals of one link group as derived values: m, m l/2, m l²/3 and those of the mode shapes."""

    def __init__(self, registry: ParameterRegistry, link: Link, properties: LinkProperties) -> None:
        # derived values are computed once for each set of parameters, not at every step
        m, length, group = properties.mass, properties.length, link.group
        integrals = link.shape_integrals()
        count = len(integrals.mean)

        def derived(name: str, expression: casadi.SX) -> casadi.SX:
            return registry.derived(f"{group}_{name}", expression)

        # the rigid link
        self.mass = m
        self.half = derived("m_l_2", m * length / 2)
        self.inertia = derived("m_l2_3", m * length**2 / 3)
        # elastic coordinates, and their coupling with the rigid motion
        self.mean = column([derived(f"mean_{k}", m * integrals.mean[k]) for k in range(count)])
        self.first = column([derived(f"first_{k}", m * length * integrals.first_moment[k]) for k in range(count)])
        self.gram = symmetric(count, lambda i, j: derived(f"gram_{i}_{j}", m * integrals.gram[i, j]), integrals.gram)

    def moment(self, link: Link) -> tuple[casadi.SX, casadi.SX]:
        """∫ (x + u_x) dm along e and ∫ u_y dm along n [kg m]."""
        axial, bending = _split(link, "q")
        k = axial.numel()
        return self.half + dot(self.mean[:k], axial), dot(self.mean[k:], bending)

    def moment_rate(self, link: Link) -> tuple[casadi.SX, casadi.SX]:
        """Rates of both in the floating frame [kg m/s]."""
        axial, bending = _split(link, "v")
        k = axial.numel()
        return dot(self.mean[:k], axial), dot(self.mean[k:], bending)

    def relative_energy(self, link: Link, w: casadi.SX) -> casadi.SX:
        """Kinetic energy of the motion relative to the base point [J]."""
        (ax, be), (axd, bed) = _split(link, "q"), _split(link, "v")
        k = ax.numel()
        gram_xx, gram_yy, gram_xy = self.gram[:k, :k], self.gram[k:, k:], self.gram[:k, k:]
        polar = self.inertia + 2 * dot(self.first[:k], ax) + form(gram_xx, ax, ax) + form(gram_yy, be, be)
        deformation = form(gram_xx, axd, axd) + form(gram_yy, bed, bed)
        coupling = dot(self.first[k:], bed) + form(gram_xy, ax, bed) - form(gram_xy, axd, be)
        return 0.5 * polar * w**2 + 0.5 * deformation + w * coupling


def _split(link: Link, kind: str) -> tuple[casadi.SX, casadi.SX]:
    """Axial and bending coordinates ("q") or rates ("v") of a link, each (K, 1), empty where rigid."""
    parts = (link.family("axial"), link.family("bending"))
    axial, bending = (casadi.SX(0, 1) if part is None else getattr(part, kind) for part in parts)
    return axial, bending

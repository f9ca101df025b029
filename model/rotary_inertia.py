"""Timoshenko beams as an effect: rotary inertia of all links, and their shear rigidity and radius of gyration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import casadi

from flexfmu.model.beams import LinkGroup, gram, mean
from flexfmu.model.effects import Effect, EffectContext, column, dot, form, symmetric
from flexfmu.model.parameters import LinkProperties, ParameterRegistry
from flexfmu.model.robot import Robot
from flexfmu.model.symbolic import EffectNote, Variable
from flexfmu.model.timoshenko import shear_coefficient
from flexfmu.trajectories.jets import RealArray


@dataclass(frozen=True)
class ThickBeam:
    """Properties of a link group that a Timoshenko beam needs in addition to `LinkProperties`, in symbols.

    Attributes:
        shear_rigidity: k G A / l [N/m].
        gyration: I/A / l², square of the radius of gyration over the length [1].
    """

    shear_rigidity: casadi.SX
    gyration: casadi.SX


def thick_beams(context: EffectContext) -> dict[LinkGroup, ThickBeam]:
    """Shear rigidity and gyration of both link groups; empty for Euler-Bernoulli beams. Registers Poisson's ratio."""
    # Euler-Bernoulli beams have neither shear nor rotary inertia
    if context.scene.effects.beam != "timoshenko":
        return {}
    nu = context.registry.parameter(
        Variable(
            "material.poissons_ratio",
            "1",
            "Poisson's ratio of the links",
            "parameter",
            start=context.scene.mechanism.material.poissons_ratio,
            minimum=-0.99,
            maximum=0.5,
        )
    )
    # properties of each link group
    beams: dict[LinkGroup, ThickBeam] = {}
    for group, part in context.links.items():
        shear_modulus = part.youngs_modulus / (2.0 * (1.0 + nu))
        k = shear_coefficient(part.outer_diameter, part.inner_diameter, nu)
        rigidity = k * shear_modulus * part.area / part.length
        beams[group] = ThickBeam(rigidity, part.second_moment / part.area / part.length**2)
    return beams


class RotaryInertia(Effect):
    """Rotary inertia of the links' cross sections and shear in their bending, after Timoshenko."""

    note = EffectNote(
        title="rotary inertia",
        sentence="Rotary inertia of the links' cross sections and shear in their bending, after Timoshenko.",
        formula="T = ½ ∑ ∫ ρI (θ̇ + ψ̇)² dx, where ψ is the turning of the section against the frame",
        contributes=("kinetic energy T",),
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        beams = thick_beams(context)
        if beams:
            yield cls(context.registry, context.links, beams)

    def __init__(
        self,
        registry: ParameterRegistry,
        properties: Mapping[LinkGroup, LinkProperties],
        beams: Mapping[LinkGroup, ThickBeam],
    ) -> None:
        self._registry, self._properties, self._beams = registry, properties, beams

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """½ ∫ rho I (w + psi')² dx, summed over the links; psi is the section rotation relative to the frame."""
        derived, total = self._registry.derived, casadi.SX(0)
        for link in robot.links.values():
            # rotation of the frame
            length, w, group = self._properties[link.group].length, link.turning_rate, link.group
            inertia = self._properties[group].mass * self._beams[group].gyration
            energy = 0.5 * derived(f"{group}_rotary", inertia * length**2) * w**2
            # rotation of the sections due to bending: coupling with the frame, and its own energy
            bending = link.family("bending")
            if bending is not None:
                products, means = (of(bending.family.shapes, lambda shape: shape.rotation) for of in (gram, mean))
                first = column([derived(f"{group}_rotary_{k}", inertia * length * m) for k, m in enumerate(means)])
                matrix = self._matrix(group, inertia, products)
                energy = energy + w * dot(first, bending.v) + 0.5 * form(matrix, bending.v, bending.v)
            total += energy
        return total

    def _matrix(self, group: LinkGroup, inertia: casadi.SX, products: RealArray) -> casadi.SX:
        """∫ rho I psi_j psi_k dx of the shapes' rotations, (K, K)."""
        return symmetric(
            len(products),
            lambda i, j: self._registry.derived(f"{group}_rotary_{i}_{j}", inertia * products[i, j]),
            products,
        )

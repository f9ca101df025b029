"""Stiffness and inertia of the links' cross sections as numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexfmu.model.robot import LinkGroup
from flexfmu.model.scene.mechanism import Link
from flexfmu.model.scene.schema import Scene
from flexfmu.model.timoshenko import shear_coefficient


@dataclass(frozen=True)
class BeamSection:
    """A uniform link.

    Attributes:
        length: l [m].
        axial: EA [N].
        bending: EI [N m²].
        shear: kGA [N]; infinite for Euler and Bernoulli's beam.
        mass: rho A [kg/m].
        rotary: rho I [kg m]; zero for Euler and Bernoulli's beam.
    """

    length: float
    axial: float
    bending: float
    shear: float
    mass: float
    rotary: float


def beam_section(scene: Scene, group: LinkGroup) -> BeamSection:
    """The links of a group, with shear and rotary inertia where ``effects.beam`` is Timoshenko's."""
    link: Link = getattr(scene.mechanism, group)
    outer, inner, material = link.diameter, link.inner_diameter, scene.mechanism.material
    area = math.pi / 4.0 * (outer**2 - inner**2)
    second = math.pi / 64.0 * (outer**4 - inner**4)
    young, nu, density = material.youngs_modulus, material.poissons_ratio, material.density
    thick = scene.effects.beam == "timoshenko"
    shear = shear_coefficient(outer, inner, nu) * young / (2.0 * (1.0 + nu)) * area
    return BeamSection(
        length=link.length,
        axial=young * area,
        bending=young * second,
        shear=shear if thick else math.inf,
        mass=density * area,
        rotary=density * second if thick else 0.0,
    )

"""Mass and stiffness properties of the links, from what a user sets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi

from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import LinkGroup


@dataclass(frozen=True)
class LinkProperties:
    """Mass [kg], length, outer and inner diameter [m], area [m²] and second moment of area [m⁴] of a link group, in symbols."""

    mass: casadi.SX
    length: casadi.SX
    outer_diameter: casadi.SX
    inner_diameter: casadi.SX
    area: casadi.SX
    second_moment: casadi.SX
    youngs_modulus: casadi.SX


def link_properties(registry: ParameterRegistry, group: LinkGroup, parameters: dict[str, casadi.SX]) -> LinkProperties:
    """Mass, area and second moment of area of a round tube or rod, as derived symbols."""
    outer, inner, length = (parameters[f"{group}.{key}"] for key in ("diameter", "inner_diameter", "length"))
    area = math.pi / 4 * (outer**2 - inner**2)
    return LinkProperties(
        mass=registry.derived(f"{group}_mass", parameters["material.density"] * area * length),
        length=registry.derived(f"{group}_length", length),
        outer_diameter=outer,
        inner_diameter=inner,
        area=area,
        second_moment=math.pi / 64 * (outer**4 - inner**4),
        youngs_modulus=parameters["material.youngs_modulus"],
    )

"""Elasticity of the links: modes with their strain energy, and what can be measured of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi
import numpy as np

from flexfmu.model.algebra import column, form, symmetric
from flexfmu.model.beams import Array, Evaluate, Shape
from flexfmu.model.effects import Effect, Output
from flexfmu.model.link_properties import LinkProperties
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Direction, Family, LinkGroup, Robot
from flexfmu.model.rotary_inertia import ThickBeam
from flexfmu.model.shape_integrals import gram, integrate_shapes


class ElasticFamily(Effect):
    """Elasticity of one link group in one direction: strain energy of eqs. (10) to (13)."""

    def __init__(
        self,
        registry: ParameterRegistry,
        properties: LinkProperties,
        group: LinkGroup,
        direction: Direction,
        shapes: tuple[Shape, ...],
        thick: ThickBeam | None = None,
        quasi_static: bool = False,
    ) -> None:
        """`thick` adds the strain energy of shear to bending, and rotary inertia to the modal masses; `quasi_static`
        takes the modes' own dynamics away."""
        integrals = integrate_shapes(shapes)
        rigidity = (
            properties.youngs_modulus * properties.second_moment / properties.length**3
            if direction == "bending"
            else properties.youngs_modulus * properties.area / properties.length
        )
        stiffness, mass = [(rigidity, integrals.strain_gram)], [(properties.mass, integrals.gram)]
        if thick is not None:
            stiffness.append((thick.shear_rigidity, gram(shapes, _shear)))
            mass.append((properties.mass * thick.gyration, gram(shapes, lambda shape: shape.rotation)))

        def matrix(name: str, terms: Sequence[tuple[casadi.SX, Array]]) -> casadi.SX:
            def entry(i: int, j: int) -> casadi.SX:
                value = sum((factor * products[i, j] for factor, products in terms), casadi.SX(0))
                return registry.derived(f"{group}_{direction}_{name}_{i}_{j}", value)

            return symmetric(len(shapes), entry, np.add.reduce([np.abs(products) for _, products in terms]))

        self._registry, self._properties, self._is_thick = registry, properties, thick is not None
        springs = matrix("k", stiffness)
        compliance = _inverse(registry, f"{group}_{direction}_compliance", springs) if quasi_static else None
        self._family = Family(group, direction, shapes, springs, matrix("m", mass), compliance)

    def families(self) -> tuple[Family, ...]:
        return (self._family,)

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        parts = (part for _, part in robot.elastic if part.family is self._family)
        return sum((0.5 * form(self._family.stiffness, part.q, part.q) for part in parts), casadi.SX(0))

    def outputs(self, robot: Robot) -> Sequence[Output]:
        mine = [(link.name, part.q) for link, part in robot.elastic if part.family is self._family]
        return (*self._tip_outputs(mine), *self._strain_outputs(mine))

    def _tip_outputs(self, mine: Sequence[tuple[str, casadi.SX]]) -> Iterator[Output]:
        name, text = _TIP_NAMES[self._family.direction]
        if any(shape.tip for shape in self._family.shapes):
            for link, q in mine:
                yield Output(f"{link}.{name}", "m", f"{text} of {link}", q, casadi.SX(self._family.tips))

    def _strain_outputs(self, mine: Sequence[tuple[str, casadi.SX]]) -> Iterator[Output]:
        """Bending strain at the clamped end, where a strain gauge would sit: D/2 times the curvature."""
        if (self._family.group, self._family.direction) != ("proximal", "bending"):
            return
        lever = self._properties.outer_diameter / (2 * self._properties.length**2)
        root = np.zeros(1)
        gain = column(
            [
                self._registry.derived(f"root_strain_{k}", lever * float(shape.strain(root)[0]))
                for k, shape in enumerate(self._family.shapes)
            ]
        )
        for link, q in mine:
            yield Output(f"{link}.root_strain", "1", f"bending strain on the outer side of the root of {link}", q, gain)

    def title(self) -> str:
        return f"{self._family.group} {'bending' if self._family.direction == 'bending' else 'elongation'}"

    def formula(self) -> str:
        if self._family.direction == "axial":
            return "V = ½ qᵀ K q = ½ ∑ ∫ EA u′² dx"
        energy = "EI ψ′² + kGA (w′ − ψ)²" if self._is_thick else "EI w″²"
        return f"V = ½ qᵀ K q = ½ ∑ ∫ {energy} dx"

    def sentence(self) -> str:
        family = self._family
        how = "that deflect statically under the present loads" if family.quasi_static else "with their vibrations"
        return f"Elasticity of the {family.group} links, {family.direction}: {len(family.shapes)} mode(s) {how}."


def _inverse(registry: ParameterRegistry, prefix: str, stiffness: casadi.SX) -> casadi.SX:
    """Inverse of a stiffness matrix (K, K), as derived values."""
    count = stiffness.shape[0]
    if stiffness.sparsity().is_diag():
        entries = [registry.derived(f"{prefix}_{i}", 1 / stiffness[i, i]) for i in range(count)]
        return casadi.diag(column(entries))
    inverse = casadi.inv(casadi.densify(stiffness))
    return symmetric(count, lambda i, j: registry.derived(f"{prefix}_{i}_{j}", inverse[i, j]), np.ones((count, count)))


def _shear(shape: Shape) -> Evaluate:
    """Shear angle times the length: what of the slope isn't turning of the sections."""
    return lambda xi: shape.slope(xi) - shape.rotation(xi)


_TIP_NAMES: dict[Direction, tuple[str, str]] = {
    "bending": (
        "tip_deflection",
        "displacement, across the undeformed axis and positive counter-clockwise, of the tip",
    ),
    "axial": ("elongation", "change of length"),
}

"""Elasticity of the links: strain energy and outputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi
import numpy as np

from flexfmu.model.beams import Direction, LinkGroup, Shape, gram, integrate_shapes
from flexfmu.model.effects import Effect, EffectContext, Output, column, form, symmetric
from flexfmu.model.link_shapes import scene_shapes
from flexfmu.model.parameters import LinkProperties, ParameterRegistry
from flexfmu.model.robot import Family, Robot
from flexfmu.model.rotary_inertia import ThickBeam, thick_beams
from flexfmu.model.symbolic import EffectNote
from flexfmu.trajectories.jets import RealArray


class ElasticFamily(Effect):
    """Elasticity of one link group in one direction: strain energy of eqs. (10) to (13)."""

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        chosen, thick = context.scene.effects, thick_beams(context)
        for (group, direction), shapes in scene_shapes(context.scene).items():
            # shear matters in bending alone
            beam = thick.get(group) if direction == "bending" else None
            static = f"{group}_{direction}" in chosen.quasi_static
            yield cls(context.registry, context.links[group], group, direction, shapes, beam, static)

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
        """`thick` adds shear to the strain energy and rotary inertia to the modal masses; `quasi_static` modes deflect
        statically."""
        # stiffness and mass terms: factor and integrals over the shapes
        integrals = integrate_shapes(shapes)
        rigidity = (
            properties.youngs_modulus * properties.second_moment / properties.length**3
            if direction == "bending"
            else properties.youngs_modulus * properties.area / properties.length
        )
        stiffness, mass = [(rigidity, integrals.strain_gram)], [(properties.mass, integrals.gram)]
        if thick is not None:
            # shear angle times the length: slope minus rotation of the sections
            shear = gram(shapes, lambda shape: lambda xi: shape.slope(xi) - shape.rotation(xi))
            stiffness.append((thick.shear_rigidity, shear))
            mass.append((properties.mass * thick.gyration, gram(shapes, lambda shape: shape.rotation)))

        def matrix(name: str, terms: Sequence[tuple[casadi.SX, RealArray]]) -> casadi.SX:
            def entry(i: int, j: int) -> casadi.SX:
                value = sum((factor * products[i, j] for factor, products in terms), casadi.SX(0))
                return registry.derived(f"{group}_{direction}_{name}_{i}_{j}", value)

            return symmetric(len(shapes), entry, np.add.reduce([np.abs(products) for _, products in terms]))

        # the family with its matrices as derived values
        self._registry, self._properties = registry, properties
        springs = matrix("k", stiffness)
        compliance = _inverse(registry, f"{group}_{direction}_compliance", springs) if quasi_static else None
        self._family = Family(group, direction, shapes, springs, matrix("m", mass), compliance)
        self.note = _note(self._family, is_thick=thick is not None)

    def families(self) -> tuple[Family, ...]:
        return (self._family,)

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        parts = (part for _, part in robot.elastic if part.family is self._family)
        return sum((0.5 * form(self._family.stiffness, part.q, part.q) for part in parts), casadi.SX(0))

    def outputs(self, robot: Robot) -> Sequence[Output]:
        family = self._family
        links = [(link.name, part.q) for link, part in robot.elastic if part.family is family]
        found: list[Output] = []
        # displacement of the tip, where it moves
        name, text = _TIP_NAMES[family.direction]
        if any(shape.tip for shape in family.shapes):
            found += [
                Output(f"{link}.{name}", "m", f"{text} of {link}", q, casadi.SX(family.tips)) for link, q in links
            ]
        # bending strain at the clamped end, as a strain gauge measures it: D/2 times the curvature
        if (family.group, family.direction) == ("proximal", "bending"):
            lever = self._properties.outer_diameter / (2 * self._properties.length**2)
            gain = column(
                [
                    self._registry.derived(f"root_strain_{k}", lever * float(shape.strain(np.zeros(1))[0]))
                    for k, shape in enumerate(family.shapes)
                ]
            )
            text = "bending strain on the outer side of the root of"
            found += [Output(f"{link}.root_strain", "1", f"{text} {link}", q, gain) for link, q in links]
        return found


def _note(family: Family, is_thick: bool) -> EffectNote:
    bends = family.direction == "bending"
    how = "that deflect statically under the present loads" if family.quasi_static else "with their vibrations"
    energy = "EA u′²" if not bends else "EI ψ′² + kGA (w′ − ψ)²" if is_thick else "EI w″²"
    return EffectNote(
        title=f"{family.group} {'bending' if bends else 'elongation'}",
        sentence=f"Elasticity of the {family.group} links, {family.direction}: {len(family.shapes)} mode(s) {how}.",
        formula=f"V = ½ qᵀ K q = ½ ∑ ∫ {energy} dx",
        contributes=("elastic coordinates", "potential energy V", "outputs"),
    )


def _inverse(registry: ParameterRegistry, prefix: str, stiffness: casadi.SX) -> casadi.SX:
    """Inverse of a stiffness matrix (K, K), as derived values."""
    count = stiffness.shape[0]
    if stiffness.sparsity().is_diag():
        entries = [registry.derived(f"{prefix}_{i}", 1 / stiffness[i, i]) for i in range(count)]
        return casadi.diag(column(entries))
    inverse = casadi.inv(casadi.densify(stiffness))
    return symmetric(count, lambda i, j: registry.derived(f"{prefix}_{i}_{j}", inverse[i, j]), np.ones((count, count)))


_TIP_NAMES: dict[Direction, tuple[str, str]] = {
    "bending": (
        "tip_deflection",
        "displacement, across the undeformed axis and positive counter-clockwise, of the tip",
    ),
    "axial": ("elongation", "change of length"),
}

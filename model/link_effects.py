"""Effects of the links: inertia, elasticity, rotary inertia and shear, foreshortening.

Each beam deforms in a floating frame. Timoshenko beams are an effect too: rotary inertia of all links, and their shear rigidity and
radius of gyration.

Foreshortening: bending moves the tip of a link towards its base, which couples bending with axial forces. The axial displacement gets
the second-order term -1/(2 l) ∫ phi_j' phi_k' q_j q_k over 0..xi. The kinetic energy contains it in all terms of second order in q:
they stiffen a rotating link (centrifugal stiffening), and stiffen or soften it under acceleration of its base. At the tip it shortens
the link in the assembly: payload, gravity and the other links then stiffen or buckle it, and the end-effector position is that of bent
links of constant length.

Sources: Kane, Ryan and Banerjee, Dynamics of a cantilever beam attached to a moving base, J. Guidance 10 (1987);
Wallrapp and Schwertassek, Representation of geometric stiffening in multibody system simulation, Int. J. Numer. Methods
Eng. 32 (1991).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import casadi
import numpy as np
from numpy.polynomial import Legendre

from flexfmu.model.beams import (
    Direction,
    Evaluate,
    LinkGroup,
    Shape,
    gram,
    integrate_shapes,
    mean,
    scene_shapes,
    shear_coefficient,
)
from flexfmu.model.effects import Effect, EffectContext, Output, column, derived_matrix, dot, form
from flexfmu.model.parameters import LinkProperties, ParameterRegistry
from flexfmu.model.robot import ElasticSymbols, Family, Link, Robot, Shortening
from flexfmu.model.symbolic import EffectNote, Variable
from flexfmu.trajectories.jets import RealArray


class LinkInertia(Effect):
    """Inertia of the four links with their displacement fields, eqs. (4) to (9) of Barnard, Briot and Caro (2012)."""

    note = EffectNote(
        "link inertia",
        "Inertia of the four links with their displacement fields, eqs. (4) to (9) of Barnard, Briot and Caro (2012).",
        "T = ½ ∑ ∫ |Ẋ|² dm, X = B + (x + u) e + w n, u and w the elastic displacements",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        yield cls(context)

    def __init__(self, context: EffectContext) -> None:
        self._registry, self._properties = context.registry, context.links

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """Kinetic energy of all links: the base point P translates, the frame rotates, the beam deforms in it."""
        total = casadi.SX(0)
        for link in robot.links.values():
            m, half, inertia, mean, first, gram = self._integrals(link)
            w, V = link.turning_rate, link.base_velocity
            (axial, bending), (axial_rate, bending_rate) = _split(link, "q"), _split(link, "v")
            k = axial.numel()
            # motion of the base point, and its product with the motion relative to it
            along, across = half + dot(mean[:k], axial), dot(mean[k:], bending)
            along_rate, across_rate = dot(mean[:k], axial_rate), dot(mean[k:], bending_rate)
            relative = (along_rate - w * across) * link.direction + (across_rate + w * along) * link.normal
            translation = 0.5 * m * casadi.dot(V, V) + casadi.dot(V, relative)
            # motion relative to the base point
            xx, yy, xy = gram[:k, :k], gram[k:, k:], gram[:k, k:]
            polar = inertia + 2 * dot(first[:k], axial) + form(xx, axial, axial) + form(yy, bending, bending)
            deformation = form(xx, axial_rate, axial_rate) + form(yy, bending_rate, bending_rate)
            coupling = dot(first[k:], bending_rate) + form(xy, axial, bending_rate) - form(xy, axial_rate, bending)
            total += translation + (0.5 * polar * w**2 + 0.5 * deformation + w * coupling)
        return total

    def first_moment(self, robot: Robot) -> casadi.SX:
        total = casadi.SX(np.zeros((2, 1)))
        for link in robot.links.values():
            m, half, _, mean, _, _ = self._integrals(link)
            axial, bending = _split(link, "q")
            k = axial.numel()
            along, across = half + dot(mean[:k], axial), dot(mean[k:], bending)
            total += m * link.base + along * link.direction + across * link.normal
        return total

    def _integrals(self, link: Link) -> tuple[casadi.SX, ...]:
        """Mass integrals of a link: m, m l/2, m l²/3; of its shapes, axial ones first: ∫ φ dm, ∫ x φ dm (K, 1), ∫ φφ' dm (K, K).

        They are derived values, computed once for each set of parameters, not at every step.
        """
        properties, group, integrals = self._properties[link.group], link.group, link.shape_integrals()
        m, length, count = properties.mass, properties.length, len(integrals.mean)

        def derived(name: str, expression: casadi.SX) -> casadi.SX:
            return self._registry.derived(f"{group}_{name}", expression)

        half, inertia = derived("m_l_2", m * length / 2), derived("m_l2_3", m * length**2 / 3)
        mean = column([derived(f"mean_{k}", m * integrals.mean[k]) for k in range(count)])
        first = column([derived(f"first_{k}", m * length * integrals.first_moment[k]) for k in range(count)])
        return (
            m,
            half,
            inertia,
            mean,
            first,
            derived_matrix(self._registry, f"{group}_gram", m * casadi.DM(integrals.gram)),
        )


def _split(link: Link, kind: str) -> tuple[casadi.SX, casadi.SX]:
    """Axial and bending coordinates ("q") or rates ("v") of a link, each (K, 1), empty where rigid."""
    parts = (link.family("axial"), link.family("bending"))
    axial, bending = (casadi.SX(0, 1) if part is None else getattr(part, kind) for part in parts)
    return axial, bending


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
    value, text = context.scene.mechanism.material.poissons_ratio, "Poisson's ratio of the links"
    nu = context.registry.parameter(
        Variable("material.poissons_ratio", "1", text, "parameter", value, minimum=-0.99, maximum=0.5)
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
        "rotary inertia",
        "Rotary inertia of the links' cross sections and shear in their bending, after Timoshenko.",
        "T = ½ ∑ ∫ ρI (θ̇ + ψ̇)² dx, where ψ is the turning of the section against the frame",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        beams = thick_beams(context)
        if beams:
            yield cls(context, beams)

    def __init__(self, context: EffectContext, beams: Mapping[LinkGroup, ThickBeam]) -> None:
        self._registry, self._properties, self._beams = context.registry, context.links, beams

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
                # ∫ rho I psi_j psi_k dx of the shapes' rotations (K, K)
                matrix = derived_matrix(self._registry, f"{group}_rotary", inertia * casadi.DM(products))
                energy = energy + w * dot(first, bending.v) + 0.5 * form(matrix, bending.v, bending.v)
            total += energy
        return total


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
        stiffness, mass = rigidity * casadi.DM(integrals.strain_gram), properties.mass * casadi.DM(integrals.gram)
        if thick is not None:
            # shear angle times the length: slope minus rotation of the sections
            shear = gram(shapes, lambda shape: lambda xi: shape.slope(xi) - shape.rotation(xi))
            stiffness += thick.shear_rigidity * casadi.DM(shear)
            mass += properties.mass * thick.gyration * casadi.DM(gram(shapes, lambda shape: shape.rotation))

        # the family with its matrices as derived values
        self._registry, self._properties = registry, properties
        springs = derived_matrix(registry, f"{group}_{direction}_k", stiffness)
        compliance = _inverse(registry, f"{group}_{direction}_compliance", springs) if quasi_static else None
        masses = derived_matrix(registry, f"{group}_{direction}_m", mass)
        self._family = Family(group, direction, shapes, springs, masses, compliance)
        how = "that deflect statically under the present loads" if quasi_static else "with their vibrations"
        bends = direction == "bending"
        energy = "EA u′²" if not bends else "EI w″²" if thick is None else "EI ψ′² + kGA (w′ − ψ)²"
        self.note = EffectNote(
            f"{group} {'bending' if bends else 'elongation'}",
            f"Elasticity of the {group} links, {direction}: {len(shapes)} mode(s) {how}.",
            f"V = ½ qᵀ K q = ½ ∑ ∫ {energy} dx",
        )

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
            strains = [float(shape.strain(np.zeros(1))[0]) for shape in family.shapes]
            gain = column([self._registry.derived(f"root_strain_{k}", lever * each) for k, each in enumerate(strains)])
            text = "bending strain on the outer side of the root of"
            found += [Output(f"{link}.root_strain", "1", f"{text} {link}", q, gain) for link, q in links]
        return found


def _inverse(registry: ParameterRegistry, prefix: str, stiffness: casadi.SX) -> casadi.SX:
    """Inverse of a stiffness matrix (K, K), as derived values."""
    count = stiffness.shape[0]
    if stiffness.sparsity().is_diag():
        entries = [registry.derived(f"{prefix}_{i}", 1 / stiffness[i, i]) for i in range(count)]
        return casadi.diag(column(entries))
    inverse = casadi.inv(casadi.densify(stiffness))
    return derived_matrix(registry, prefix, inverse)


_TIP_NAMES: dict[Direction, tuple[str, str]] = {
    "bending": (
        "tip_deflection",
        "displacement, across the undeformed axis and positive counter-clockwise, of the tip",
    ),
    "axial": ("elongation", "change of length"),
}


class Foreshortening(Effect):
    """Second-order shortening of bending links: geometric stiffening by rotation, payload, gravity and joint forces."""

    note = EffectNote(
        "foreshortening",
        "Second-order shortening of links that bend: geometric stiffening by rotation, payload, gravity and joint forces.",
        "u = −1/(2l) ∑ ∫ φ_j′ φ_k′ dξ q_j q_k",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        chosen = context.scene.effects
        if chosen.foreshortening is True and (chosen.proximal_bending or chosen.distal_bending):
            yield cls(context)

    def __init__(self, context: EffectContext) -> None:
        self._registry, self._properties = context.registry, context.links

    def shortening(self, family: Family) -> Shortening | None:
        if family.direction != "bending":
            return None
        matrix = self._matrix(family, "shortening", np.ones_like, 1.0 / self._properties[family.group].length)
        return Shortening(
            lambda q: casadi.dot(q, matrix @ q) / 2, lambda q: matrix @ q, lambda q, v: casadi.dot(v, matrix @ v)
        )

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
        return derived_matrix(self._registry, f"{family.group}_{name}", factor * casadi.DM(products))


SPARE_NODES = 3
"""Gauss-Legendre nodes of exact bending in addition to one for each mode, see ``tests/model/test_effects.py``."""

SHIFTS = 2
"""Number of shapes of the axial displacement due to bending that have kinetic energy of their own."""


@dataclass(frozen=True)
class Nodes:
    """Gauss-Legendre quadrature over 0..1 with N nodes, and integrals of an integral s(xi) = ∫ a from 0 to xi.

    Attributes:
        places, weights: (N,).
        moments: (N, N); ∫ s f dxi = a' moments f for the values a and f at the nodes.
        squares: (`SHIFTS`, N); ∫ s² dxi is the square of the norm of squares a, but for what rarer shapes of s add.
    """

    places: RealArray
    weights: RealArray
    moments: RealArray
    squares: RealArray

    @staticmethod
    @cache
    def of(count: int) -> Nodes:
        places, weights = (0.5 * each for each in np.polynomial.legendre.leggauss(count))
        places += 0.5
        # integrals of the polynomial through all values, from 0 to each node
        basis = [Legendre.basis(k, domain=[0.0, 1.0]) for k in range(count)]
        values, integrals = (
            np.stack([each(places) for each in some], axis=1)
            for some in (basis, [each.integ(lbnd=0.0) for each in basis])
        )
        moments = (weights[:, None] * (integrals @ np.linalg.inv(values))).T
        sizes, vectors = np.linalg.eigh(moments @ (moments.T / weights[:, None]))
        squares = np.sqrt(sizes[-SHIFTS:, None]) * vectors.T[-SHIFTS:]
        return Nodes(places, weights, moments, squares)

    def fields(self, family: Family, name: Literal["value", "slope", "rotation", "strain"]) -> casadi.DM:
        """A field of the family's shapes at the nodes (N, K)."""
        return casadi.DM(np.stack([getattr(shape, name)(self.places) for shape in family.shapes], axis=1))


class ExactBending(Effect):
    """Geometrically exact bending of links of constant length, in place of `Foreshortening`.

    Coordinates are those of the linear beam: w(x), the displacement across the undeformed axis at the arc length x. Its derivative is
    the sine of the axis' angle, so that the axis advances by c = √(1 - w'²) and its curvature is w''/c. The rotation of Timoshenko's
    sections is the sine of their angle likewise. What the energies have beyond those of the linear beam is integrated over `Nodes`.

    Sources: Crespo da Silva and Glynn, Nonlinear flexural-flexural-torsional dynamics of inextensional beams, J. Struct. Mech. 6
    (1978), in the plane; Simo and Vu-Quoc, On the dynamics of flexible beams under large overall motions, J. Appl. Mech. 53 (1986).
    """

    note = EffectNote(
        "geometrically exact bending",
        "Geometrically exact bending of links of constant length, whose sections turn by any angle below 90°.",
        "V = ½ ∑ ∫ EI w″²/(1 − w′²) dx, u = ∫ (√(1 − w′²) − 1) dx",
    )

    @classmethod
    def from_scene(cls, context: EffectContext) -> Iterator[Effect]:
        chosen = context.scene.effects
        if chosen.foreshortening == "exact" and (chosen.proximal_bending or chosen.distal_bending):
            yield cls(context)

    def __init__(self, context: EffectContext) -> None:
        self._registry, self._properties = context.registry, context.links
        self._thick, self._damping_time = thick_beams(context), context.damping_time()
        self._nodes = {
            group: Nodes.of(SPARE_NODES + getattr(context.scene.effects, f"{group}_bending")) for group in context.links
        }

    def shortening(self, family: Family) -> Shortening | None:
        if family.direction != "bending":
            return None
        q, v = (casadi.SX.sym(name, len(family.shapes)) for name in ("q", "v"))
        advance = _advance(self._relative(family, "slope", q))
        amount = -self._properties[family.group].length * casadi.dot(
            casadi.DM(self._nodes[family.group].weights), advance
        )
        gradient = casadi.gradient(amount, q)
        curvature = casadi.jtimes(casadi.dot(gradient, v), q, v)
        return Shortening(
            lambda other: casadi.substitute(amount, q, other),
            lambda other: casadi.substitute(gradient, q, other),
            lambda other, rates: casadi.substitute(curvature, casadi.vertcat(q, v), casadi.vertcat(other, rates)),
        )

    def first_moment(self, robot: Robot) -> casadi.SX:
        total = casadi.SX(np.zeros((2, 1)))
        for link, part in _bending(robot):
            moments = casadi.DM(self._nodes[link.group].moments)
            advance = _advance(self._relative(part.family, "slope", part.q))
            total += self._moment(link) * casadi.dot(casadi.sum2(moments), advance) * link.direction
        return total

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """The terms with the axial displacement s due to bending in ½ ∫ |V + d/dt ((x + u + s) e + w n)|² dm; and of the sections' turning."""
        total = casadi.SX(0)
        for link, part in _bending(robot):
            turning, family, nodes = link.turning_rate, part.family, self._nodes[link.group]
            length, moment = self._properties[link.group].length, self._moment(link)
            advance = _advance(self._relative(family, "slope", part.q))
            rate = casadi.jtimes(advance, part.q, part.v)
            # velocity of the nodes without s, along and across the link, as it enters the moments of s
            moments, base = casadi.DM(nodes.moments), link.base_velocity
            shapes = moments @ nodes.fields(family, "value")
            along = casadi.sum2(moments) * casadi.dot(base, link.direction) - turning * (shapes @ part.q)
            place = length * (moments @ casadi.DM(nodes.places))
            if (axial := link.family("axial")) is not None:
                stretch = moments @ nodes.fields(axial.family, "value")
                along, place = along + stretch @ axial.v, place + stretch @ axial.q
            across = casadi.sum2(moments) * casadi.dot(base, link.normal) + shapes @ part.v + turning * place
            total += moment * (casadi.dot(rate, along) + turning * casadi.dot(advance, across))
            # velocity of s itself
            own, own_rate = casadi.DM(nodes.squares) @ advance, casadi.DM(nodes.squares) @ rate
            squares = casadi.dot(own_rate, own_rate) + turning**2 * casadi.dot(own, own)
            total += 0.5 * self._registry.derived(f"{link.group}_m_l2", moment * length) * squares
            # rotary inertia: the sections turn faster than the sine of their angle
            if link.group in self._thick:
                sine, rate = (self._relative(family, "rotation", each) for each in (part.q, part.v))
                squares = (turning + rate / _cosine(sine)) ** 2 - (turning + rate) ** 2
                inertia = self._registry.derived(
                    f"{link.group}_gyration", moment * length * self._thick[link.group].gyration
                )
                total += 0.5 * inertia * casadi.dot(casadi.DM(nodes.weights), squares)
        return total

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        return self._strain_energy(robot, lambda strain, q, v: strain)

    def dissipation(self, robot: Robot) -> casadi.SX:
        if self._damping_time is None:
            return casadi.SX(0)
        return self._registry.derived("damping_time", self._damping_time) * self._strain_energy(robot, casadi.jtimes)

    def _strain_energy(self, robot: Robot, of: Callable[[casadi.SX, casadi.SX, casadi.SX], casadi.SX]) -> casadi.SX:
        """Energy of exact strains less that of the linear beam's, or of their rates: ½ ∫ EI κ² + kGA γ² dx."""
        total = casadi.SX(0)
        for link, part in _bending(robot):
            properties, family, group = self._properties[link.group], part.family, link.group
            length, sine = properties.length, self._relative(family, "rotation", part.q)
            rigidity = properties.youngs_modulus * properties.second_moment / length
            strains = [("bending", rigidity, self._relative(family, "strain", part.q))]
            if group in self._thick:
                shear = self._relative(family, "slope", part.q) - sine
                strains.append(("shear", self._thick[group].shear_rigidity * length**2, shear))
            # a stretched link turns less for the same displacement
            turning = _cosine(sine)
            if (axial := link.family("axial")) is not None:
                turning *= 1.0 + self._relative(axial.family, "strain", axial.q)
            q, v = (casadi.vertcat(*(getattr(each, kind) for each in link.elastic)) for kind in ("q", "v"))
            for name, factor, linear in strains:
                squares = of(linear / turning, q, v) ** 2 - of(linear, q, v) ** 2
                stiffness = self._registry.derived(f"{group}_{name}_rigidity", factor)
                total += 0.5 * stiffness * casadi.dot(casadi.DM(self._nodes[group].weights), squares)
        return total

    def _moment(self, link: Link) -> casadi.SX:
        """Mass times length [kg m]."""
        properties = self._properties[link.group]
        return self._registry.derived(f"{link.group}_m_l", properties.mass * properties.length)

    def _relative(self, family: Family, name: Literal["slope", "rotation", "strain"], q: casadi.SX) -> casadi.SX:
        """A field over the length, at the nodes (N, 1), for the coordinates q or their rates (K, 1) [m]."""
        inverse = self._registry.derived(f"{family.group}_inverse_length", 1.0 / self._properties[family.group].length)
        return self._nodes[family.group].fields(family, name) @ (inverse * q)


def _cosine(sine: casadi.SX) -> casadi.SX:
    return casadi.sqrt(1.0 - sine**2)


def _advance(sine: casadi.SX) -> casadi.SX:
    """Cosine less one, without cancellation."""
    return -(sine**2) / (1.0 + _cosine(sine))


def _bending(robot: Robot) -> Iterator[tuple[Link, ElasticSymbols]]:
    return ((link, part) for link, part in robot.elastic if part.family.direction == "bending")

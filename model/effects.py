"""The effects of the model: each adds coordinates, energies, dissipation and outputs, and knows nothing of the others.

The sum of all effects is the model; an effect that a scene leaves out isn't constructed, so it leaves no state, no term
and no line in the generated C.
"""

from __future__ import annotations

import math
import re
from abc import ABC
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import casadi
import numpy as np

from flexfmu.model.beams import Shape, clamped_free_bending, fixed_free_axial, integrate_shapes, pinned_pinned_bending
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Direction, Family, Link, LinkGroup, Robot
from flexfmu.model.symbolic import Variable

SHAPES: dict[tuple[LinkGroup, Direction], Callable[[int], Shape]] = {
    ("proximal", "bending"): clamped_free_bending,
    ("proximal", "axial"): fixed_free_axial,
    ("distal", "bending"): pinned_pinned_bending,
    ("distal", "axial"): fixed_free_axial,
}
"""The paper's boundary conditions: proximal links are clamped to the motors, distal links are pinned at both ends."""


@dataclass(frozen=True)
class Output:
    """A scalar that follows from the elastic coordinates linearly: gain' q.

    Attributes:
        name, unit, description: as FMI shows it.
        coordinates: the elastic coordinates (K, 1) of one link.
        gain: shape (K, 1), of numbers or derived values.
    """

    name: str
    unit: str
    description: str
    coordinates: casadi.SX
    gain: casadi.SX


class Effect(ABC):  # noqa: B024 - every hook has a neutral default
    """What an effect may contribute; each hook's default is nothing."""

    def families(self) -> tuple[Family, ...]:
        """Elastic families that the effect adds to the links."""
        return ()

    def twists_joints(self) -> bool:
        """Whether the effect makes the joints' transmissions elastic."""
        return False

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        """T [J]."""
        return casadi.SX(0)

    def first_moment(self, robot: Robot) -> casadi.SX:
        """Sum of mass times position (2, 1) [kg m], for gravity."""
        return casadi.SX(np.zeros((2, 1)))

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        """V [J]; `first_moment` is the sum over all effects."""
        return casadi.SX(0)

    def dissipation(self, robot: Robot) -> casadi.SX:
        """Rayleigh's function R [W], half the power that is lost."""
        return casadi.SX(0)

    def outputs(self, robot: Robot) -> Sequence[Output]:
        """Scalars worth watching."""
        return ()

    def title(self) -> str:
        """What the documentation calls the effect, for example ``point payload``."""
        return re.sub(r"(?<!^)(?=[A-Z])", " ", type(self).__name__).lower()

    def sentence(self) -> str:
        """One sentence for the documentation."""
        return (self.__doc__ or "").split("\n")[0]


@dataclass(frozen=True)
class LinkProperties:
    """Mass [kg], length, outer diameter [m], area [m²] and second moment of area [m⁴] of a link group, in symbols."""

    mass: casadi.SX
    length: casadi.SX
    outer_diameter: casadi.SX
    area: casadi.SX
    second_moment: casadi.SX
    youngs_modulus: casadi.SX


class LinkInertia(Effect):
    """Inertia of the four links with their displacement fields, eqs. (4) to (9)."""

    def __init__(self, registry: ParameterRegistry, properties: Mapping[LinkGroup, LinkProperties]) -> None:
        self._registry, self._properties = registry, properties

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        return sum((self._link_energy(link) for link in robot.links.values()), casadi.SX(0))

    def first_moment(self, robot: Robot) -> casadi.SX:
        return sum((self._link_moment(link) for link in robot.links.values()), casadi.SX(np.zeros((2, 1))))

    def _inertia(self, link: Link) -> _LinkIntegrals:
        return _LinkIntegrals(self._registry, link, self._properties[link.group])

    def _link_moment(self, link: Link) -> casadi.SX:
        inertia = self._inertia(link)
        along, across = inertia.moment(link)
        return inertia.mass * link.base + along * link.direction + across * link.normal

    def _link_energy(self, link: Link) -> casadi.SX:
        """T of one link: point P translates, the frame turns, the beam deforms in it."""
        inertia, w, V = self._inertia(link), link.turning_rate, link.base_velocity
        along, across = inertia.moment(link)
        along_rate, across_rate = inertia.moment_rate(link)
        relative = (along_rate - w * across) * link.direction + (across_rate + w * along) * link.normal
        translation = 0.5 * inertia.mass * casadi.dot(V, V) + casadi.dot(V, relative)
        return translation + inertia.relative_energy(link, w)


class _LinkIntegrals:
    """Mass integrals of one link group as derived symbols: m, m l/2, m l²/3 and those with the mode shapes."""

    def __init__(self, registry: ParameterRegistry, link: Link, properties: LinkProperties) -> None:
        m, length, group = properties.mass, properties.length, link.group
        integrals = link.shape_integrals()
        count = len(integrals.mean)

        def derived(name: str, expression: casadi.SX) -> casadi.SX:
            return registry.derived(f"{group}_{name}", expression)

        self.mass = m
        self.half = derived("m_l_2", m * length / 2)
        self.inertia = derived("m_l2_3", m * length**2 / 3)
        self.mean = _column([derived(f"mean_{k}", m * integrals.mean[k]) for k in range(count)])
        self.first = _column([derived(f"first_{k}", m * length * integrals.first_moment[k]) for k in range(count)])
        self.gram = _symmetric(count, lambda i, j: derived(f"gram_{i}_{j}", m * integrals.gram[i, j]), integrals.gram)

    def moment(self, link: Link) -> tuple[casadi.SX, casadi.SX]:
        """∫ (x + u_x) dm along e and ∫ u_y dm along n [kg m]."""
        axial, bending = _split(link, "q")
        k = axial.numel()
        return self.half + _dot(self.mean[:k], axial), _dot(self.mean[k:], bending)

    def moment_rate(self, link: Link) -> tuple[casadi.SX, casadi.SX]:
        """The same for the displacements' rates [kg m/s]."""
        axial, bending = _split(link, "v")
        k = axial.numel()
        return _dot(self.mean[:k], axial), _dot(self.mean[k:], bending)

    def relative_energy(self, link: Link, w: casadi.SX) -> casadi.SX:
        """Kinetic energy with respect to the base point [J]."""
        (ax, be), (axd, bed) = _split(link, "q"), _split(link, "v")
        k = ax.numel()
        gram_xx, gram_yy, gram_xy = self.gram[:k, :k], self.gram[k:, k:], self.gram[:k, k:]
        polar = self.inertia + 2 * _dot(self.first[:k], ax) + _form(gram_xx, ax, ax) + _form(gram_yy, be, be)
        deformation = _form(gram_xx, axd, axd) + _form(gram_yy, bed, bed)
        coupling = _dot(self.first[k:], bed) + _form(gram_xy, ax, bed) - _form(gram_xy, axd, be)
        return 0.5 * polar * w**2 + 0.5 * deformation + w * coupling


class ElasticFamily(Effect):
    """Elasticity of one link group in one direction: strain energy of eqs. (10) to (13)."""

    def __init__(
        self,
        registry: ParameterRegistry,
        properties: LinkProperties,
        group: LinkGroup,
        direction: Direction,
        modes: int,
    ) -> None:
        shapes = tuple(SHAPES[group, direction](k) for k in range(1, modes + 1))
        integrals = integrate_shapes(shapes)
        rigidity = (
            properties.youngs_modulus * properties.second_moment / properties.length**3
            if direction == "bending"
            else properties.youngs_modulus * properties.area / properties.length
        )

        def matrix(name: str, factor: casadi.SX, gram: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> casadi.SX:
            prefix = f"{group}_{direction}_{name}"
            return _symmetric(modes, lambda i, j: registry.derived(f"{prefix}_{i}_{j}", factor * gram[i, j]), gram)

        self._registry, self._properties = registry, properties
        self._family = Family(
            group,
            direction,
            shapes,
            matrix("k", rigidity, integrals.strain_gram),
            matrix("m", properties.mass, integrals.gram),
        )

    def families(self) -> tuple[Family, ...]:
        return (self._family,)

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        parts = (part for _, part in robot.elastic if part.family is self._family)
        return sum((0.5 * _form(self._family.stiffness, part.q, part.q) for part in parts), casadi.SX(0))

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
        gain = _column(
            [
                self._registry.derived(f"root_strain_{k}", lever * float(shape.strain(root)[0]))
                for k, shape in enumerate(self._family.shapes)
            ]
        )
        for link, q in mine:
            yield Output(
                f"{link}.root_strain", "1", f"bending strain at the root of {link}, on its outer side,", q, gain
            )

    def title(self) -> str:
        return f"{self._family.group} {'bending' if self._family.direction == 'bending' else 'elongation'}"

    def sentence(self) -> str:
        family = self._family
        return f"Elasticity of the {family.group} links, {family.direction}, with {len(family.shapes)} assumed mode(s)."


_TIP_NAMES: dict[Direction, tuple[str, str]] = {
    "bending": ("tip_deflection", "displacement of the tip across the undeformed axis, positive counter-clockwise,"),
    "axial": ("elongation", "change of length"),
}


class PointPayload(Effect):
    """Point mass at the end effector."""

    def __init__(self, registry: ParameterRegistry, mass: float) -> None:
        self._mass = registry.derived(
            "payload_mass",
            registry.parameter(
                Variable(
                    "payload.mass",
                    "kg",
                    "Point mass at the end effector",
                    "parameter",
                    start=mass,
                    minimum=0.0,
                    maximum=1e6,
                )
            ),
        )

    def kinetic_energy(self, robot: Robot) -> casadi.SX:
        return 0.5 * self._mass * casadi.dot(robot.velocity, robot.velocity)

    def first_moment(self, robot: Robot) -> casadi.SX:
        return self._mass * robot.position


class Gravity(Effect):
    """Uniform gravity of any direction in the plane, eq. (14)."""

    def __init__(self, registry: ParameterRegistry, gravity: tuple[float, float]) -> None:
        self._gravity = casadi.vertcat(
            *(
                registry.derived(
                    f"gravity_{axis}",
                    registry.parameter(
                        Variable(
                            f"gravity.{axis}",
                            "m/s2",
                            f"Gravity along {axis}",
                            "parameter",
                            start=g,
                            minimum=-1e4,
                            maximum=1e4,
                        )
                    ),
                )
                for axis, g in zip("xy", gravity, strict=True)
            )
        )

    def potential_energy(self, robot: Robot, first_moment: casadi.SX) -> casadi.SX:
        return -casadi.dot(self._gravity, first_moment)


class ModalDamping(Effect):
    """Modal damping C_ii = 2 ratio sqrt(K_ii M_ii) of every mode of every link."""

    def __init__(self, registry: ParameterRegistry, ratio: float) -> None:
        self._registry = registry
        self._ratio = registry.parameter(
            Variable(
                "damping.ratio",
                "1",
                "Modal damping ratio of the link modes",
                "parameter",
                start=ratio,
                minimum=0.0,
                maximum=1.0,
            )
        )

    def dissipation(self, robot: Robot) -> casadi.SX:
        return sum((self._power(part.family, part.v) for _, part in robot.elastic), casadi.SX(0))

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        total = casadi.SX(0)
        for k in range(v.numel()):
            c = 2 * self._ratio * casadi.sqrt(family.stiffness[k, k] * family.mass[k, k])
            total += 0.5 * self._registry.derived(f"{family.group}_{family.direction}_c_{k}", c) * v[k] ** 2
        return total


class StiffnessDamping(Effect):
    """Stiffness-proportional damping C = time * K on the elastic coordinates."""

    def __init__(self, registry: ParameterRegistry, time: float) -> None:
        self._registry = registry
        self._time = registry.parameter(
            Variable(
                "damping.time",
                "s",
                "Stiffness-proportional damping time",
                "parameter",
                start=time,
                minimum=0.0,
                maximum=1e3,
            )
        )

    def dissipation(self, robot: Robot) -> casadi.SX:
        return sum((self._power(part.family, part.v) for _, part in robot.elastic), casadi.SX(0))

    def _power(self, family: Family, v: casadi.SX) -> casadi.SX:
        prefix, stiffness = f"{family.group}_{family.direction}_c", family.stiffness
        damping = _symmetric(
            v.numel(),
            lambda i, j: self._registry.derived(f"{prefix}_{i}_{j}", self._time * stiffness[i, j]),
            np.array(casadi.DM(stiffness.sparsity(), 1.0).full()),
        )
        return 0.5 * _form(damping, v, v)


def link_properties(registry: ParameterRegistry, group: LinkGroup, parameters: dict[str, casadi.SX]) -> LinkProperties:
    """Mass, area and second moment of area of a round tube or rod, as derived symbols."""
    outer, inner, length = (parameters[f"{group}.{key}"] for key in ("diameter", "inner_diameter", "length"))
    area = math.pi / 4 * (outer**2 - inner**2)
    return LinkProperties(
        mass=registry.derived(f"{group}_mass", parameters["material.density"] * area * length),
        length=registry.derived(f"{group}_length", length),
        outer_diameter=outer,
        area=area,
        second_moment=math.pi / 64 * (outer**4 - inner**4),
        youngs_modulus=parameters["material.youngs_modulus"],
    )


def _split(link: Link, kind: str) -> tuple[casadi.SX, casadi.SX]:
    """Axial and bending coordinates ("q") or rates ("v") of a link, each (K, 1), empty where rigid."""
    parts = (link.family("axial"), link.family("bending"))
    axial, bending = (casadi.SX(0, 1) if part is None else getattr(part, kind) for part in parts)
    return axial, bending


def _column(entries: Sequence[casadi.SX]) -> casadi.SX:
    return casadi.vertcat(casadi.SX(0, 1), *entries)


def _symmetric(
    count: int, entry: Callable[[int, int], casadi.SX], pattern: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> casadi.SX:
    """A symmetric matrix with entries only where the pattern is not an exact zero; upper and lower share their symbols."""
    matrix = casadi.SX(count, count)
    for i in range(count):
        for j in range(i, count):
            if pattern[i, j]:
                matrix[i, j] = matrix[j, i] = entry(i, j)
    return matrix


def _dot(left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' right, zero for empty vectors."""
    return casadi.dot(left, right) if right.numel() else casadi.SX(0)


def _form(matrix: casadi.SX, left: casadi.SX, right: casadi.SX) -> casadi.SX:
    """left' matrix right, zero for empty vectors."""
    return casadi.bilin(matrix, left, right) if left.numel() and right.numel() else casadi.SX(0)

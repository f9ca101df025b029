"""Mode shapes of uniform beams over the normalised length xi in [0, 1], and the integrals of them that the model needs.

A scene chooses between two bases. Proximal links are clamped to the motors, distal links are pinned at both ends. With
`assumed-modes` the shapes are those of eqs. (1) and (2) of Barnard, Briot and Caro (ESDA 2012), without normalisation. With
`craig-bampton` the first shape of a family is the static deflection under a tip force, and the others are fixed-interface modes,
whose tip is fixed. The static shape alone contains the whole compliance at the tip, so few coordinates suffice (Craig and Bampton,
AIAA Journal 6, 1968). Hinges transmit no moment, so there is no static shape for one. The tip of a pinned-pinned link has no
transverse displacement, so both bases are the same there.

The evaluation of bending shapes avoids the cancellation of cosh and sinh, so that a high mode is as accurate as the first (Blevins,
Formulas for Natural Frequency and Mode Shape, 1979, table 8-1). Integrals are Gauss-Legendre quadratures.

Shapes of Timoshenko beams depend on the slenderness of the beam. After a change of the model's parameters they are still admissible
(Ritz), but no longer the exact modes. Sources: Huang, The effect of rotatory inertia and of shear deformation on the frequency and
normal mode equations of uniform beams, J. Appl. Mech. 28 (1961); Han, Benaroya and Wei, Dynamics of transversely vibrating beams using
four engineering theories, J. Sound Vib. 225 (1999); Cowper, The shear coefficient in Timoshenko's beam theory, J. Appl. Mech. 33 (1966).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from numpy.polynomial import Legendre

from flexfmu.model.scene.mechanism import LinkSection, Mechanism
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.roots import root_between

if TYPE_CHECKING:
    import casadi

Evaluate = Callable[[RealArray], RealArray]
Basis = Literal["assumed-modes", "craig-bampton"]
"""Set of shape functions of the elastic links, see `flexfmu.model.beams`."""

LinkGroup = Literal["proximal", "distal"]
Direction = Literal["axial", "bending"]
"""Of a deflection."""


@dataclass(frozen=True)
class Shape:
    """A dimensionless mode shape phi(xi) with the derivatives that the energies need; all take xi (N,).

    Attributes:
        value: phi, the displacement.
        slope: dphi/dxi, slope of the beam's axis.
        rotation: rotation of the cross sections times the length; equal to the slope without shear deformation.
        strain: drotation/dxi for bending, dphi/dxi for axial shapes.
        tip: phi(1).
        wave_number: dimensionless wave number, which sets the number of quadrature nodes.
        text: description of the shape, for the documentation.
    """

    value: Evaluate
    slope: Evaluate
    rotation: Evaluate
    strain: Evaluate
    tip: float
    wave_number: float
    text: str


@dataclass(frozen=True)
class Slenderness:
    """Slenderness of a beam: rotary = I/(A l²), shear = EI/(k G A l²)."""

    rotary: float
    shear: float


THIN = Slenderness(0.0, 0.0)
"""That of an Euler-Bernoulli beam."""

STATIC = "Craig and Bampton's static shape under a force at the tip, as the tip's displacement"
THICK = ", with shear and rotary inertia"
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")


def ordinal(mode: int) -> str:
    """The ordinal of a mode number: ``first`` to ``tenth``, then ``11th``, ``12th``, ..."""
    return _ORDINALS[mode - 1] if mode <= len(_ORDINALS) else f"{mode}th"


def fixed_interface(mode: int) -> str:
    """The description of a fixed-interface mode."""
    return f"Craig and Bampton's {ordinal(mode)} mode with the tip held"


def _root_near(centre: float, function: Callable[[float], float]) -> float:
    """The root of a characteristic equation within ±0.5 of an approximate wave number."""
    return root_between(function, centre - 0.5, centre + 0.5, absolute=1e-15, relative=1e-15)


def clamped_free_bending(mode: int) -> Shape:
    """Clamped-free bending shape k, eq. (1): sin + a_k cos - sinh - a_k cosh of beta_k xi.

    With sigma = -1/a_k it equals (cosh - cos - sigma (sinh - sin)) / sigma.
    """
    # cos(beta) cosh(beta) = -1
    beta = _root_near((mode - 0.5) * np.pi, lambda b: float(np.cos(b) + 1.0 / np.cosh(b)))
    decay = np.exp(-beta)
    # 1 - sigma = (exp(-beta) + cos beta + sin beta) / (cosh beta + cos beta), scaled by exp(beta) to avoid overflow
    scaled = 2.0 * (decay + np.cos(beta) + np.sin(beta)) / (1.0 + decay**2 + 2.0 * decay * np.cos(beta))
    sigma = 1.0 - decay * scaled
    value, slope, curvature = _clamped(beta, scaled, sigma, divisor=sigma)
    text = f"the paper's {ordinal(mode)} assumed mode, eq. (1)"
    return Shape(value, slope, slope, curvature, float(value(np.array([1.0]))[0]), beta, text)


def clamped_pinned_bending(mode: int) -> Shape:
    """Clamped-pinned bending shape k: cosh - cos - sigma (sinh - sin) of beta_k xi; the tip only rotates."""
    # tan(beta) = tanh(beta)
    beta = _root_near((mode + 0.25) * np.pi, lambda b: float(np.sin(b) - np.cos(b) * np.tanh(b)))
    decay = np.exp(-beta)
    # 1 - sigma = (cos beta - sin beta - exp(-beta)) / (sinh beta - sin beta), where cos beta - sin beta is
    # 2 exp(-2 beta) cos beta / (1 + exp(-2 beta)); scaled by exp(beta)
    scaled = 2.0 * decay * (2.0 * decay * np.cos(beta) / (1.0 + decay**2) - 1.0)
    scaled /= 1.0 - decay**2 - 2.0 * decay * np.sin(beta)
    value, slope, curvature = _clamped(beta, scaled, 1.0 - decay * scaled, divisor=1.0)
    return Shape(value, slope, slope, curvature, 0.0, beta, fixed_interface(mode))


def _clamped(beta: float, scaled: float, sigma: float, divisor: float) -> tuple[Evaluate, Evaluate, Evaluate]:
    """Value, slope and curvature of (cosh - cos - sigma (sinh - sin)) / divisor of beta xi.

    cosh - sigma sinh is evaluated as exp(-x) + (1 - sigma) sinh(x), which has no cancellation; `scaled` is
    (1 - sigma) exp(beta).
    """

    # hyperbolic parts without cancellation at large arguments
    def hyperbolic(x: RealArray) -> RealArray:
        """cosh - sigma sinh."""
        growing = 0.5 * scaled * (np.exp(x - beta) - np.exp(-x - beta))
        return np.asarray(np.exp(-x) + growing)

    def hyperbolic_slope(x: RealArray) -> RealArray:
        """sinh - sigma cosh."""
        growing = 0.5 * scaled * (np.exp(x - beta) + np.exp(-x - beta))
        return np.asarray(growing - np.exp(-x))

    # the shape and its derivatives with respect to xi
    def value(xi: RealArray) -> RealArray:
        x = beta * xi
        return np.asarray((hyperbolic(x) - np.cos(x) + sigma * np.sin(x)) / divisor)

    def slope(xi: RealArray) -> RealArray:
        x = beta * xi
        return np.asarray(beta * (hyperbolic_slope(x) + np.sin(x) + sigma * np.cos(x)) / divisor)

    def curvature(xi: RealArray) -> RealArray:
        x = beta * xi
        return np.asarray(beta**2 * (hyperbolic(x) + np.cos(x) - sigma * np.sin(x)) / divisor)

    return value, slope, curvature


def tip_force_bending(slenderness: Slenderness = THIN) -> Shape:
    """Static shape of a cantilever under a tip force, (3 xi² - xi³)/2 + 3 s xi, scaled to 1 at the tip: its coordinate is the tip
    displacement."""
    # share of bending in the tip deflection; shear has the rest
    share = 1.0 / (1.0 + 3.0 * slenderness.shear)
    linear = 3.0 * slenderness.shear

    def slope(xi: RealArray) -> RealArray:
        return np.asarray(share * (3.0 * xi - 1.5 * xi**2 + linear))

    return Shape(
        value=lambda xi: share * (1.5 * xi**2 - 0.5 * xi**3 + linear * xi),
        slope=slope,
        rotation=lambda xi: share * (3.0 * xi - 1.5 * xi**2),
        strain=lambda xi: share * (3.0 - 3.0 * xi),
        tip=1.0,
        wave_number=3.0,
        text=STATIC,
    )


def pinned_pinned_bending(mode: int, slenderness: Slenderness = THIN) -> Shape:
    """Pinned-pinned shape k: sin(k pi xi); the tip doesn't move, the section rotation is proportional to cos(k pi xi)."""
    # the lower root of the frequency equation
    k, r, s = mode * np.pi, slenderness.rotary, slenderness.shear
    b = 1.0 + k**2 * (r + s)
    square = 2.0 * k**4 / (b + np.sqrt(b**2 - 4.0 * r * s * k**4))
    # rotation of the section = slope minus shear angle
    turning = k - square * s / k
    return Shape(
        value=lambda xi: np.sin(k * xi),
        slope=lambda xi: k * np.cos(k * xi),
        rotation=lambda xi: turning * np.cos(k * xi),
        strain=lambda xi: -turning * k * np.sin(k * xi),
        tip=0.0,
        wave_number=k,
        text=f"{ordinal(mode)} mode of a beam pinned at both ends" + (THICK if slenderness.shear else ""),
    )


def fixed_free_axial(mode: int) -> Shape:
    """Fixed-free axial shape k, eq. (2): sin((2k - 1) pi/2 xi)."""
    text = f"the paper's {ordinal(mode)} assumed mode, eq. (2)"
    return _sine_axial((mode - 0.5) * np.pi, 1.0 if mode % 2 else -1.0, text)


def fixed_fixed_axial(mode: int) -> Shape:
    """Fixed-fixed axial shape k: sin(k pi xi); the tip doesn't move."""
    return _sine_axial(mode * np.pi, 0.0, fixed_interface(mode))


def tip_force_axial() -> Shape:
    """Static shape of a rod under a force at its tip, xi; its coordinate is the elongation."""
    return _axial(lambda xi: 1.0 * xi, np.ones_like, 1.0, 1.0, STATIC)


def _sine_axial(k: float, tip: float, text: str) -> Shape:
    return _axial(lambda xi: np.sin(k * xi), lambda xi: k * np.cos(k * xi), tip, k, text)


def _axial(value: Evaluate, strain: Evaluate, tip: float, wave_number: float, text: str) -> Shape:
    """An axial shape; its cross sections don't rotate."""
    return Shape(value, strain, np.zeros_like, strain, tip, wave_number, text)


INTEGRAL_ROUNDING = 1e-12
"""An integral below this fraction of the product of its factors' norms counts as exactly zero (orthogonality)."""


@dataclass(frozen=True)
class ShapeIntegrals:
    """Integrals over xi in [0, 1] of a set of K shapes.

    Attributes:
        mean: ∫ phi_k, shape (K,).
        first_moment: ∫ xi phi_k, shape (K,).
        gram: ∫ phi_j phi_k, shape (K, K), exactly zero where the shapes are orthogonal.
        strain_gram: ∫ of strain_j strain_k, shape (K, K); meaningful only within one family.
    """

    mean: RealArray
    first_moment: RealArray
    gram: RealArray
    strain_gram: RealArray


def integrate_shapes(shapes: Sequence[Shape]) -> ShapeIntegrals:
    """Integrals of the shapes by Gauss-Legendre quadrature, exact to rounding for the highest mode too."""
    xi, weights, values = _quadrature(shapes, lambda shape: shape.value)
    return ShapeIntegrals(
        values @ weights,
        values @ (weights * xi),
        gram(shapes, lambda shape: shape.value),
        gram(shapes, lambda shape: shape.strain),
    )


def gram(shapes: Sequence[Shape], field: Callable[[Shape], Evaluate], weight: Evaluate = np.ones_like) -> RealArray:
    """∫ weight(xi) f_j f_k of a field f of the shapes, shape (K, K), exactly zero where they are orthogonal."""
    xi, weights, values = _quadrature(shapes, field)
    products = (values * weights * weight(xi)) @ values.T
    norms = np.sqrt(np.diag(products))
    return np.where(np.abs(products) > INTEGRAL_ROUNDING * np.outer(norms, norms), products, 0.0)


def mean(shapes: Sequence[Shape], field: Callable[[Shape], Evaluate]) -> RealArray:
    """∫ f_k of a field f of the shapes, shape (K,), exactly zero where the integral vanishes."""
    _, weights, values = _quadrature(shapes, field)
    means = values @ weights
    return np.where(np.abs(means) > INTEGRAL_ROUNDING * np.sqrt(values**2 @ weights), means, 0.0)


def _quadrature(shapes: Sequence[Shape], field: Callable[[Shape], Evaluate]) -> tuple[RealArray, RealArray, RealArray]:
    """Gauss-Legendre nodes and weights on [0, 1], enough of them for the largest wave number, and a field of the shapes (K, N)."""
    count = 40 + int(max((shape.wave_number for shape in shapes), default=0.0))
    nodes, weights = np.polynomial.legendre.leggauss(count)
    xi = 0.5 * (nodes + 1.0)
    return xi, 0.5 * weights, np.array([field(shape)(xi) for shape in shapes]).reshape(len(shapes), count)


SPARE_POLYNOMIALS = 20
"""Number of polynomials in addition to two for each mode; the modes converge exponentially."""

Number = TypeVar("Number", float, "casadi.SX")


def shear_coefficient(outer: Number, inner: Number, poissons_ratio: Number) -> Number:
    """Shear coefficient k of a round tube or rod with diameters in m, Cowper (1966)."""
    ratio = (inner / outer) ** 2
    bore = (1.0 + ratio) ** 2
    nu = poissons_ratio
    return 6.0 * (1.0 + nu) * bore / ((7.0 + 6.0 * nu) * bore + (20.0 + 12.0 * nu) * ratio)


def slenderness(mechanism: Mechanism, group: LinkGroup) -> Slenderness:
    """The slenderness of a link group with the values of the scene, for the mode shapes."""
    link: LinkSection = getattr(mechanism, group)
    nu = mechanism.material.poissons_ratio
    rotary = (link.diameter**2 + link.inner_diameter**2) / (16.0 * link.length**2)
    k = shear_coefficient(link.diameter, link.inner_diameter, nu)
    return Slenderness(rotary, 2.0 * (1.0 + nu) / k * rotary)


def _clamped_modes(modes: int, slenderness: Slenderness, tip_held: bool) -> tuple[Shape, ...]:
    """Modes of a clamped beam with a free or a pinned tip, by a Ritz method in polynomials, converged to rounding."""
    from scipy.linalg import eigh  # here, since other beams need no scipy

    if modes < 1:
        return ()
    # trial functions that satisfy the clamp, and the pin if there is one
    count = 2 * modes + SPARE_POLYNOMIALS
    xi = Legendre([0.5, 0.5], domain=[0.0, 1.0])
    rotations = [xi * Legendre.basis(k, domain=[0.0, 1.0]) for k in range(count)]
    displacements = [(1.0 - xi) * rotation for rotation in rotations] if tip_held else rotations
    # mass and stiffness from kinetic and strain energy, by a quadrature that is exact for these polynomials
    nodes, weights = np.polynomial.legendre.leggauss(count + 3)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights

    def table(functions: list[Legendre]) -> RealArray:
        return np.array([function(nodes) for function in functions])

    zeros = np.zeros((count, len(nodes)))
    displacement, rotation = np.vstack([table(displacements), zeros]), np.vstack([zeros, table(rotations)])
    curvature = np.vstack([zeros, table([f.deriv() for f in rotations])])
    shear = np.vstack([table([f.deriv() for f in displacements]), -table(rotations)])
    mass = (displacement * weights) @ displacement.T + slenderness.rotary * (rotation * weights) @ rotation.T
    stiffness = (curvature * weights) @ curvature.T + (shear * weights) @ shear.T / slenderness.shear
    _, vectors = eigh(stiffness, mass, subset_by_index=(0, modes - 1))
    # unit modal mass, and positive curvature at the clamp
    shapes = []
    for mode, vector in enumerate(vectors.T, 1):
        value, turning = (
            sum((factor * f for factor, f in zip(factors, functions, strict=True)), Legendre([0.0], domain=[0.0, 1.0]))
            for factors, functions in ((vector[:count], displacements), (vector[count:], rotations))
        )
        if turning.deriv()(0.0) <= 0.0:
            value, turning = -value, -turning
        text = fixed_interface(mode) if tip_held else f"{ordinal(mode)} mode of a clamped beam"
        shapes.append(
            Shape(
                value=value,
                slope=value.deriv(),
                rotation=turning,
                strain=turning.deriv(),
                tip=0.0 if tip_held else float(value(1.0)),
                wave_number=float(len(value.coef)),
                text=text + THICK,
            )
        )
    return tuple(shapes)


FAMILIES: tuple[tuple[LinkGroup, Direction], ...] = (
    ("proximal", "axial"),
    ("proximal", "bending"),
    ("distal", "axial"),
    ("distal", "bending"),
)
"""Elastic families: link group and direction of deflection."""


def family_shapes(
    basis: Basis, group: LinkGroup, direction: Direction, modes: int, slenderness: Slenderness = THIN
) -> tuple[Shape, ...]:
    """The first `modes` shapes of a family; slenderness is that of a Timoshenko beam that bends."""
    numbers, static_first = range(1, modes + 1), basis == "craig-bampton"
    # the tip of a pinned-pinned link is at rest in both bases
    if (group, direction) == ("distal", "bending"):
        return tuple(pinned_pinned_bending(k, slenderness) for k in numbers)
    if slenderness.shear:
        static, dynamic = (
            tip_force_bending(slenderness),
            _clamped_modes(modes - static_first, slenderness, static_first),
        )
    elif direction == "bending":
        static, shape = tip_force_bending(), clamped_pinned_bending if static_first else clamped_free_bending
        dynamic = tuple(shape(k) for k in numbers)
    else:
        static, shape = tip_force_axial(), fixed_fixed_axial if static_first else fixed_free_axial
        dynamic = tuple(shape(k) for k in numbers)
    return (static, *dynamic)[:modes] if static_first else dynamic


def scene_shapes(scene: Scene) -> dict[tuple[LinkGroup, Direction], tuple[Shape, ...]]:
    """The shapes of each elastic family that the scene has, in the order of `FAMILIES`; those of its beam theory."""
    chosen, found = scene.effects, dict[tuple[LinkGroup, Direction], tuple[Shape, ...]]()
    for group, direction in FAMILIES:
        if modes := getattr(chosen, f"{group}_{direction}"):
            # shear matters in bending alone
            thick = direction == "bending" and chosen.beam == "timoshenko"
            slender = slenderness(scene.mechanism, group) if thick else THIN
            found[group, direction] = family_shapes(chosen.basis, group, direction, modes, slender)
    return found


LINKS: tuple[tuple[str, LinkGroup], ...] = (
    ("link11", "proximal"),
    ("link21", "proximal"),
    ("link12", "distal"),
    ("link22", "distal"),
)
"""Names of the links and their groups."""


def fibre_strains(
    scene: Scene, link: str, group: LinkGroup, direction: Direction, places: RealArray
) -> tuple[list[str], RealArray]:
    """The modes of a link in one direction, and their strains of the outer fibre (modes, places) [1/m].

    Args:
        scene: the robot.
        link, group: one of `LINKS`.
        direction: ``bending`` or ``axial``.
        places: distances from the link's base (places,), relative to its length.
    """
    shapes = scene_shapes(scene).get((group, direction), ())
    names = [f"{link}.{direction}[{k}]" for k in range(1, len(shapes) + 1)]
    section = getattr(scene.mechanism, group)
    lever = 0.5 * section.diameter / section.length if direction == "bending" else 1.0
    return names, lever / section.length * np.array([shape.strain(places) for shape in shapes]).reshape(-1, places.size)

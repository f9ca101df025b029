"""Mode shapes of uniform Timoshenko beams: displacement and rotation of the cross sections.

The shapes depend on the slenderness of the beam. After a change of the model's parameters they are still admissible
(Ritz), but no longer the exact modes.

Sources: Huang, The effect of rotatory inertia and of shear deformation on the frequency and normal mode equations of
uniform beams, J. Appl. Mech. 28 (1961); Han, Benaroya and Wei, Dynamics of transversely vibrating beams using four
engineering theories, J. Sound Vib. 225 (1999); Cowper, The shear coefficient in Timoshenko's beam theory, J. Appl.
Mech. 33 (1966).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.polynomial import Legendre

from flexfmu.model.beams import STATIC, Basis, Evaluate, LinkGroup, Shape, fixed_interface, ordinal, pinned_pinned
from flexfmu.model.scene.mechanism import LinkSection, Mechanism
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    import casadi

SPARE_POLYNOMIALS = 20
"""Number of polynomials in addition to two for each mode; the modes converge exponentially."""

Number = TypeVar("Number", float, "casadi.SX")


@dataclass(frozen=True)
class Slenderness:
    """Slenderness of a beam, both zero for an Euler-Bernoulli beam: rotary = I/(A l²), shear = EI/(k G A l²)."""

    rotary: float
    shear: float


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


def timoshenko_shapes(basis: Basis, group: LinkGroup, modes: int, slenderness: Slenderness) -> tuple[Shape, ...]:
    """The first `modes` bending shapes of a link group, like `flexfmu.model.link_shapes.family_shapes`."""
    if group == "distal":
        return tuple(pinned_pinned_timoshenko(k, slenderness) for k in range(1, modes + 1))
    if basis == "craig-bampton":
        return (tip_force_timoshenko(slenderness), *_clamped_modes(modes - 1, slenderness, tip_held=True))
    return _clamped_modes(modes, slenderness, tip_held=False)


def tip_force_timoshenko(slenderness: Slenderness) -> Shape:
    """Static shape of a cantilever under a tip force: (3 xi² - xi³)/2 + 3 s xi, scaled to 1 at the tip."""
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


def pinned_pinned_timoshenko(mode: int, slenderness: Slenderness) -> Shape:
    """Pinned-pinned shape k: sin(k pi xi); its section rotation is proportional to cos(k pi xi)."""
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
        text=f"{pinned_pinned(mode)}, with shear and rotary inertia",
    )


def _clamped_modes(modes: int, slenderness: Slenderness, tip_held: bool) -> tuple[Shape, ...]:
    """Modes of a clamped beam with a free or a pinned tip, by a Ritz method in polynomials, converged to rounding."""
    from scipy.linalg import eigh  # here, since other beams need no scipy

    if not modes:
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
    return tuple(
        _polynomial_shape(_sum(displacements, vector[:count]), _sum(rotations, vector[count:]), mode, tip_held)
        for mode, vector in enumerate(vectors.T, 1)
    )


def _sum(functions: list[Legendre], factors: RealArray) -> Legendre:
    return sum((factor * f for factor, f in zip(factors, functions, strict=True)), Legendre([0.0], domain=[0.0, 1.0]))


def _polynomial_shape(displacement: Legendre, rotation: Legendre, mode: int, tip_held: bool) -> Shape:
    """A polynomial shape with unit modal mass and positive curvature at the clamp."""
    # sign of the curvature at the clamp
    sign = 1.0 if rotation.deriv()(0.0) > 0.0 else -1.0
    value, turning = sign * displacement, sign * rotation
    return Shape(
        value=_evaluate(value),
        slope=_evaluate(value.deriv()),
        rotation=_evaluate(turning),
        strain=_evaluate(turning.deriv()),
        tip=0.0 if tip_held else float(value(1.0)),
        wave_number=float(len(value.coef)),
        text=(fixed_interface(mode) if tip_held else f"{ordinal(mode)} mode of a clamped beam")
        + ", with shear and rotary inertia",
    )


def _evaluate(polynomial: Callable[[RealArray], RealArray]) -> Evaluate:
    return lambda xi: np.asarray(polynomial(xi))

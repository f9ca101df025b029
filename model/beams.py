"""Mode shapes of uniform beams over the normalised length xi in [0, 1], and the integrals of them that the model needs.

The assumed modes are those of eqs. (1) and (2) of Barnard, Briot and Caro (ESDA 2012), without normalisation. The
static and fixed-interface shapes are those of Craig and Bampton (AIAA Journal 6, 1968); the interface is a link's tip.
The evaluation of bending shapes avoids the cancellation of cosh and sinh, so that a high mode is as accurate as the
first (Blevins, Formulas for Natural Frequency and Mode Shape, 1979, table 8-1). Integrals are Gauss-Legendre
quadratures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.roots import root_between

Evaluate = Callable[[RealArray], RealArray]
Basis = Literal["assumed-modes", "craig-bampton"]
"""Set of shape functions of the elastic links, see `flexfmu.model.link_shapes`."""

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


STATIC = "Craig and Bampton's static shape under a force at the tip, as the tip's displacement"
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")


def ordinal(mode: int) -> str:
    """The ordinal of a mode number: ``first`` to ``tenth``, then ``11th``, ``12th``, ..."""
    return _ORDINALS[mode - 1] if mode <= len(_ORDINALS) else f"{mode}th"


def fixed_interface(mode: int) -> str:
    """The description of a fixed-interface mode."""
    return f"Craig and Bampton's {ordinal(mode)} mode with the tip held"


def pinned_pinned(mode: int) -> str:
    """The description of a pinned-pinned mode."""
    return f"{ordinal(mode)} mode of a beam pinned at both ends"


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


def tip_force_bending() -> Shape:
    """Static shape of a cantilever under a tip force, (3 xi² - xi³)/2; its coordinate is the tip displacement."""

    def slope(xi: RealArray) -> RealArray:
        return np.asarray(3.0 * xi - 1.5 * xi**2)

    return Shape(lambda xi: 1.5 * xi**2 - 0.5 * xi**3, slope, slope, lambda xi: 3.0 - 3.0 * xi, 1.0, 3.0, STATIC)


def pinned_pinned_bending(mode: int) -> Shape:
    """Pinned-pinned bending shape k: sin(k pi xi); the tip doesn't move."""
    k = mode * np.pi

    def slope(xi: RealArray) -> RealArray:
        return np.asarray(k * np.cos(k * xi))

    return Shape(
        lambda xi: np.sin(k * xi), slope, slope, lambda xi: -(k**2) * np.sin(k * xi), 0.0, k, pinned_pinned(mode)
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

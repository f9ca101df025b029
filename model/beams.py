"""Mode shapes of uniform beams and their integrals over the normalised length xi in [0, 1].

Shapes stand as in eqs. (1) and (2) of Barnard, Briot and Caro (ESDA 2012), not normalised. Bending shapes are evaluated
without the cancellation of cosh against sinh, so that a high mode is as accurate as the first (Blevins, Formulas for
Natural Frequency and Mode Shape, 1979, table 8-1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]
Evaluate = Callable[[Array], Array]

INTEGRAL_ROUNDING = 1e-12
"""Integrals below this fraction of their factors' norms are rounding of an exact zero (orthogonality)."""


@dataclass(frozen=True)
class Shape:
    """A mode shape phi(xi), dimensionless, with the derivative that its strain needs.

    Attributes:
        value: phi at xi (N,).
        strain: d²phi/dxi² for bending, dphi/dxi for axial shapes, at xi (N,).
        tip: phi(1).
        wave_number: dimensionless wave number; tells how fine a quadrature has to be.
    """

    value: Evaluate
    strain: Evaluate
    tip: float
    wave_number: float


def clamped_free_root(mode: int) -> float:
    """The root beta_k of cos(beta) cosh(beta) = -1 for mode k = 1, 2, ..."""
    centre = (mode - 0.5) * np.pi
    return float(brentq(lambda b: np.cos(b) + 1.0 / np.cosh(b), centre - 0.5, centre + 0.5, xtol=1e-15, rtol=1e-15))


def clamped_free_bending(mode: int) -> Shape:
    """Clamped-free bending shape k, eq. (1): sin + a_k cos - sinh - a_k cosh of beta_k xi.

    With sigma = -1/a_k it equals (cosh - cos - sigma (sinh - sin)) / sigma; cosh - sigma sinh is evaluated as
    exp(-x) + (1 - sigma) sinh(x), which has no cancellation.
    """
    beta = clamped_free_root(mode)
    decay = np.exp(-beta)
    # 1 - sigma = (exp(-beta) + cos beta + sin beta) / (cosh beta + cos beta), scaled by exp(beta) to avoid overflow
    scaled = 2.0 * (decay + np.cos(beta) + np.sin(beta)) / (1.0 + decay**2 + 2.0 * decay * np.cos(beta))
    sigma = 1.0 - decay * scaled

    def hyperbolic(x: Array) -> Array:
        """cosh - sigma sinh."""
        growing = 0.5 * scaled * (np.exp(x - beta) - np.exp(-x - beta))
        return np.asarray(np.exp(-x) + growing)

    def value(xi: Array) -> Array:
        x = beta * xi
        return np.asarray((hyperbolic(x) - np.cos(x) + sigma * np.sin(x)) / sigma)

    def curvature(xi: Array) -> Array:
        x = beta * xi
        return np.asarray(beta**2 * (hyperbolic(x) + np.cos(x) - sigma * np.sin(x)) / sigma)

    return Shape(value, curvature, float(value(np.array([1.0]))[0]), beta)


def pinned_pinned_bending(mode: int) -> Shape:
    """Pinned-pinned bending shape k: sin(k pi xi); the tip doesn't move."""
    k = mode * np.pi
    return Shape(lambda xi: np.sin(k * xi), lambda xi: -(k**2) * np.sin(k * xi), 0.0, k)


def fixed_free_axial(mode: int) -> Shape:
    """Fixed-free axial shape k, eq. (2): sin((2k - 1) pi/2 xi)."""
    k = (mode - 0.5) * np.pi
    return Shape(lambda xi: np.sin(k * xi), lambda xi: k * np.cos(k * xi), 1.0 if mode % 2 else -1.0, k)


@dataclass(frozen=True)
class ShapeIntegrals:
    """Integrals over xi in [0, 1] of a set of K shapes; dimensionless constants of the model.

    Attributes:
        mean: ∫ phi_k, shape (K,).
        first_moment: ∫ xi phi_k, shape (K,).
        gram: ∫ phi_j phi_k, shape (K, K), exact zeros where the shapes are orthogonal.
        strain_gram: ∫ of the products of the strain derivatives, shape (K, K); meaningful within one family.
    """

    mean: Array
    first_moment: Array
    gram: Array
    strain_gram: Array


def integrate_shapes(shapes: Sequence[Shape]) -> ShapeIntegrals:
    """Integrals by Gauss-Legendre quadrature, fine enough for the highest mode to be exact to rounding."""
    count = 40 + int(max((shape.wave_number for shape in shapes), default=0.0))
    nodes, weights = np.polynomial.legendre.leggauss(count)
    xi, w = 0.5 * (nodes + 1.0), 0.5 * weights
    values = np.array([shape.value(xi) for shape in shapes]).reshape(len(shapes), count)
    strains = np.array([shape.strain(xi) for shape in shapes]).reshape(len(shapes), count)
    return ShapeIntegrals(values @ w, values @ (w * xi), _gram(values, w), _gram(strains, w))


def _gram(values: Array, weights: Array) -> Array:
    products = (values * weights) @ values.T
    norms = np.sqrt(np.diag(products))
    return np.where(np.abs(products) > INTEGRAL_ROUNDING * np.outer(norms, norms), products, 0.0)

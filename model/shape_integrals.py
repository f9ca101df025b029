"""Integrals of mode shapes over the normalised length xi in [0, 1]: dimensionless constants of the model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexfmu.model.beams import Array, Evaluate, Shape

INTEGRAL_ROUNDING = 1e-12
"""Integrals below this fraction of their factors' norms are rounding of an exact zero (orthogonality)."""


@dataclass(frozen=True)
class ShapeIntegrals:
    """Integrals over xi in [0, 1] of a set of K shapes.

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
    xi, weights = _quadrature(shapes)
    values = np.array([shape.value(xi) for shape in shapes]).reshape(len(shapes), len(xi))
    return ShapeIntegrals(
        values @ weights,
        values @ (weights * xi),
        gram(shapes, lambda shape: shape.value),
        gram(shapes, lambda shape: shape.strain),
    )


def gram(shapes: Sequence[Shape], field: Callable[[Shape], Evaluate], weight: Evaluate = np.ones_like) -> Array:
    """∫ weight(xi) f_j f_k of a field f of the shapes, shape (K, K), exact zeros where they are orthogonal."""
    xi, weights = _quadrature(shapes)
    values = np.array([field(shape)(xi) for shape in shapes]).reshape(len(shapes), len(xi))
    products = (values * weights * weight(xi)) @ values.T
    norms = np.sqrt(np.diag(products))
    return np.where(np.abs(products) > INTEGRAL_ROUNDING * np.outer(norms, norms), products, 0.0)


def mean(shapes: Sequence[Shape], field: Callable[[Shape], Evaluate]) -> Array:
    """∫ f_k of a field f of the shapes, shape (K,), exact zeros where it averages out."""
    xi, weights = _quadrature(shapes)
    values = np.array([field(shape)(xi) for shape in shapes]).reshape(len(shapes), len(xi))
    means = values @ weights
    return np.where(np.abs(means) > INTEGRAL_ROUNDING * np.sqrt(values**2 @ weights), means, 0.0)


def _quadrature(shapes: Sequence[Shape]) -> tuple[Array, Array]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    count = 40 + int(max((shape.wave_number for shape in shapes), default=0.0))
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * (nodes + 1.0), 0.5 * weights

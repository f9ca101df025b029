"""Mode shapes of uniform beams over the normalised length xi in [0, 1].

The assumed modes stand as in eqs. (1) and (2) of Barnard, Briot and Caro (ESDA 2012), not normalised; the static and
fixed-interface shapes are those of Craig and Bampton (AIAA Journal 6, 1968), where a link's tip is the interface. Bending
shapes are evaluated without the cancellation of cosh against sinh, so that a high mode is as accurate as the first (Blevins,
Formulas for Natural Frequency and Mode Shape, 1979, table 8-1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]
Evaluate = Callable[[Array], Array]


@dataclass(frozen=True)
class Shape:
    """A mode shape phi(xi), dimensionless, with the derivatives that energies need, all at xi (N,).

    Attributes:
        value: phi, the displacement.
        slope: dphi/dxi, of the beam's axis.
        rotation: turning of the cross sections times the length; the slope, unless shear takes part of it.
        strain: drotation/dxi for bending, dphi/dxi for axial shapes.
        tip: phi(1).
        wave_number: dimensionless wave number; tells how fine a quadrature has to be.
        text: what the shape's coordinate is, for documentation.
    """

    value: Evaluate
    slope: Evaluate
    rotation: Evaluate
    strain: Evaluate
    tip: float
    wave_number: float
    text: str = "the paper's shape"


STATIC = "the static shape, tip displacement"
FIXED_INTERFACE = "shape with the link's tip held"


def clamped_free_root(mode: int) -> float:
    """The root beta_k of cos(beta) cosh(beta) = -1 for mode k = 1, 2, ..."""
    centre = (mode - 0.5) * np.pi
    return float(brentq(lambda b: np.cos(b) + 1.0 / np.cosh(b), centre - 0.5, centre + 0.5, xtol=1e-15, rtol=1e-15))


def clamped_pinned_root(mode: int) -> float:
    """The root beta_k of tan(beta) = tanh(beta) for mode k = 1, 2, ..."""
    centre = (mode + 0.25) * np.pi
    return float(
        brentq(lambda b: np.sin(b) - np.cos(b) * np.tanh(b), centre - 0.5, centre + 0.5, xtol=1e-15, rtol=1e-15)
    )


def clamped_free_bending(mode: int) -> Shape:
    """Clamped-free bending shape k, eq. (1): sin + a_k cos - sinh - a_k cosh of beta_k xi.

    With sigma = -1/a_k it equals (cosh - cos - sigma (sinh - sin)) / sigma.
    """
    beta = clamped_free_root(mode)
    decay = np.exp(-beta)
    # 1 - sigma = (exp(-beta) + cos beta + sin beta) / (cosh beta + cos beta), scaled by exp(beta) to avoid overflow
    scaled = 2.0 * (decay + np.cos(beta) + np.sin(beta)) / (1.0 + decay**2 + 2.0 * decay * np.cos(beta))
    sigma = 1.0 - decay * scaled
    value, slope, curvature = _clamped(beta, scaled, sigma, divisor=sigma)
    return Shape(value, slope, slope, curvature, float(value(np.array([1.0]))[0]), beta)


def clamped_pinned_bending(mode: int) -> Shape:
    """Clamped-pinned bending shape k: cosh - cos - sigma (sinh - sin) of beta_k xi; the tip turns, but doesn't move."""
    beta = clamped_pinned_root(mode)
    decay = np.exp(-beta)
    # 1 - sigma = (cos beta - sin beta - exp(-beta)) / (sinh beta - sin beta), where cos beta - sin beta is
    # 2 exp(-2 beta) cos beta / (1 + exp(-2 beta)); scaled by exp(beta)
    scaled = 2.0 * decay * (2.0 * decay * np.cos(beta) / (1.0 + decay**2) - 1.0)
    scaled /= 1.0 - decay**2 - 2.0 * decay * np.sin(beta)
    value, slope, curvature = _clamped(beta, scaled, 1.0 - decay * scaled, divisor=1.0)
    return Shape(value, slope, slope, curvature, 0.0, beta, FIXED_INTERFACE)


def _clamped(beta: float, scaled: float, sigma: float, divisor: float) -> tuple[Evaluate, Evaluate, Evaluate]:
    """Value, slope and curvature of (cosh - cos - sigma (sinh - sin)) / divisor of beta xi.

    cosh - sigma sinh is evaluated as exp(-x) + (1 - sigma) sinh(x), which has no cancellation; `scaled` is
    (1 - sigma) exp(beta).
    """

    def hyperbolic(x: Array) -> Array:
        """cosh - sigma sinh."""
        growing = 0.5 * scaled * (np.exp(x - beta) - np.exp(-x - beta))
        return np.asarray(np.exp(-x) + growing)

    def hyperbolic_slope(x: Array) -> Array:
        """sinh - sigma cosh."""
        growing = 0.5 * scaled * (np.exp(x - beta) + np.exp(-x - beta))
        return np.asarray(growing - np.exp(-x))

    def value(xi: Array) -> Array:
        x = beta * xi
        return np.asarray((hyperbolic(x) - np.cos(x) + sigma * np.sin(x)) / divisor)

    def slope(xi: Array) -> Array:
        x = beta * xi
        return np.asarray(beta * (hyperbolic_slope(x) + np.sin(x) + sigma * np.cos(x)) / divisor)

    def curvature(xi: Array) -> Array:
        x = beta * xi
        return np.asarray(beta**2 * (hyperbolic(x) + np.cos(x) - sigma * np.sin(x)) / divisor)

    return value, slope, curvature


def tip_force_bending() -> Shape:
    """Static shape of a cantilever under a force at its tip, (3 xi² - xi³)/2; its coordinate is the tip's displacement."""

    def slope(xi: Array) -> Array:
        return np.asarray(3.0 * xi - 1.5 * xi**2)

    return Shape(lambda xi: 1.5 * xi**2 - 0.5 * xi**3, slope, slope, lambda xi: 3.0 - 3.0 * xi, 1.0, 3.0, STATIC)


def pinned_pinned_bending(mode: int) -> Shape:
    """Pinned-pinned bending shape k: sin(k pi xi); the tip doesn't move."""
    k = mode * np.pi

    def slope(xi: Array) -> Array:
        return np.asarray(k * np.cos(k * xi))

    return Shape(lambda xi: np.sin(k * xi), slope, slope, lambda xi: -(k**2) * np.sin(k * xi), 0.0, k)


def fixed_free_axial(mode: int) -> Shape:
    """Fixed-free axial shape k, eq. (2): sin((2k - 1) pi/2 xi)."""
    return _sine_axial((mode - 0.5) * np.pi, 1.0 if mode % 2 else -1.0)


def fixed_fixed_axial(mode: int) -> Shape:
    """Fixed-fixed axial shape k: sin(k pi xi); the tip doesn't move."""
    return _sine_axial(mode * np.pi, 0.0, FIXED_INTERFACE)


def tip_force_axial() -> Shape:
    """Static shape of a rod under a force at its tip, xi; its coordinate is the elongation."""
    return _axial(lambda xi: 1.0 * xi, np.ones_like, 1.0, 1.0, STATIC)


def _sine_axial(k: float, tip: float, text: str = Shape.text) -> Shape:
    return _axial(lambda xi: np.sin(k * xi), lambda xi: k * np.cos(k * xi), tip, k, text)


def _axial(value: Evaluate, strain: Evaluate, tip: float, wave_number: float, text: str) -> Shape:
    """An axial shape, whose sections don't turn."""
    return Shape(value, strain, np.zeros_like, strain, tip, wave_number, text)

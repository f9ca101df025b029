"""Blends: the curves of the paper, by exact arc length."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import fresnel

from flexfmu.trajectories.jets import Jet, RealArray, arctan2, sqrt
from flexfmu.trajectories.path import (
    HIGHEST_RATIO,
    LOWEST_RATIO,
    Blend,
    ClothoidPair,
    LameBlend,
    PolarPolynomial,
    aspect_ratio,
)

KINDS: tuple[Callable[[float, float], Blend], ...] = (LameBlend, ClothoidPair, PolarPolynomial)
ROUNDING = 1e-15
"""Error that rounding leaves of a value of size 1; it grows by less than a factor of 4 with each derivative."""

seeded = settings(max_examples=40)
extents = st.floats(0.002, 0.2)
ratios = {LameBlend: st.floats(0.1, 10.0), PolarPolynomial: st.floats(0.1, 10.0), ClothoidPair: st.floats(0.563, 1.778)}


@st.composite
def blends(draw: st.DrawFn) -> Blend:
    """A blend of any kind with feasible extents."""
    kind = draw(st.sampled_from(KINDS))
    height = draw(extents)
    return kind(height, height * draw(ratios[kind]))


def sampled(blend: Blend, order: int, points: int = 201) -> tuple[Jet, Jet]:
    """Jets along the whole blend."""
    return blend.curve.jets(np.linspace(0.0, blend.curve.length, points), order)


def growth(x: Jet, y: Jet) -> RealArray:
    """1/R [1/m], shape (N,), so that the k-th coefficients of x and y are at most R^(1-k): their natural size."""
    coefficients = np.abs(np.stack([x.coefficients[2:], y.coefficients[2:]]))
    return np.asarray(np.max(coefficients ** (1.0 / np.arange(1, x.order))[:, None], axis=(0, 1)))


def scaled(jet: Jet, rate: RealArray) -> RealArray:
    """Coefficients in units of their natural size."""
    return np.abs(jet.coefficients / rate ** np.arange(jet.order + 1)[:, None])


@seeded
@given(blends())
def test_a_blend_goes_from_the_lift_into_the_crossing(blend: Blend) -> None:
    """Protects position, tangent and curvature at both ends, which make the path's curvature continuous."""
    x, y = (jet.derivatives() for jet in blend.curve.jets([0.0, blend.curve.length], 2))
    size = max(blend.height, blend.width)
    np.testing.assert_allclose([x[0, 0], y[0, 0]], [0.0, 0.0], atol=1e-15 * size)
    np.testing.assert_allclose([x[0, 1], y[0, 1]], [blend.width, blend.height], atol=2e-15 * size)
    np.testing.assert_allclose([x[1, 0], y[1, 0], x[1, 1], y[1, 1]], [0.0, 1.0, 1.0, 0.0], atol=1e-14)
    np.testing.assert_allclose([x[2], y[2]], 0.0, atol=1e-10 / min(blend.height, blend.width))


@seeded
@given(blends())
def test_arc_length_runs_at_unit_speed(blend: Blend) -> None:
    """Protects exact arc length to order 8: |X'| = 1 and hence X'·X'' = 0 with all further derivatives."""
    x, y = sampled(blend, 9)
    rate = growth(x, y)
    dx, dy = x.differentiate(), y.differentiate()
    error = scaled(dx * dx + dy * dy - 1.0, rate).max(axis=1)
    assert np.all(error < ROUNDING * 4.0 ** np.arange(9))


@seeded
@given(extents, ratios[LameBlend])
def test_lame_fulfils_its_equation_in_all_derivatives(height: float, ratio: float) -> None:
    """Protects the curve itself: ((e - x)/e)³ + (y/d)³ = 1 with eight derivatives along it."""
    blend = LameBlend(height, height * ratio)
    x, y = sampled(blend, 8)
    u, v = 1.0 - x / blend.width, y / blend.height
    assert scaled(u * u * u + v * v * v - 1.0, growth(x, y)).max() < ROUNDING * 4.0**8


@seeded
@given(extents, ratios[PolarPolynomial])
def test_polar_polynomial_fulfils_its_equation_in_all_derivatives(height: float, ratio: float) -> None:
    """Protects the curve itself, as the affine image of r(φ) = 1 + φ²/2 - φ³/Φ + φ⁴/(2Φ²), Φ = π/2."""
    blend = PolarPolynomial(height, height * ratio)
    x, y = sampled(blend, 8)
    u, v = 1.0 - x / blend.width, y / blend.height
    phi, full = arctan2(v, u), 0.5 * math.pi
    polynomial = 1.0 + phi * phi / 2.0 - phi * phi * phi / full + phi * phi * phi * phi / (2.0 * full**2)
    assert scaled(sqrt(u * u + v * v) - polynomial, growth(x, y)).max() < ROUNDING * 4.0**8


@seeded
@given(st.floats(0.002, 0.2), st.floats(0.5622, 1.7789))
def test_curvature_rises_and_falls_linearly(height: float, ratio: float) -> None:
    """Protects the definition: 0 → k → 0, linear on each part, turning α and π/2 - α, continuous in the middle."""
    pair = ClothoidPair(height, height * ratio)
    curve, (knot,) = pair.curve, pair.curve.knots
    s = np.linspace(0.0, curve.length, 101)
    x, y = (jet.derivatives() for jet in curve.jets(s, 3))
    curvature = y[1] * x[2] - x[1] * y[2]
    peak = 2.0 * pair.first_turning / knot
    expected = peak * np.where(s < knot, s / knot, (curve.length - s) / (curve.length - knot))
    shorter = min(
        knot, curve.length - knot
    )  # rounding of s by 1 ulp moves the curvature by this much of the shorter part
    np.testing.assert_allclose(curvature, expected, rtol=0, atol=(2e-15 + 4e-16 * curve.length / shorter) * peak)
    assert peak * curve.length == pytest.approx(math.pi, rel=1e-14)  # the area of a triangle is the turning


def test_limits_of_the_ratio_follow_from_a_single_clothoid() -> None:
    """Protects the limits: where one part vanishes e/d is a ratio of Fresnel integrals at 1, just beyond the limits."""
    sine, cosine = fresnel(1.0)
    assert aspect_ratio(0.0) == pytest.approx(cosine / sine, rel=1e-15)
    assert aspect_ratio(0.5 * math.pi) == pytest.approx(sine / cosine, rel=1e-15)
    assert 0.0 < LOWEST_RATIO - sine / cosine < 2e-4
    assert 0.0 < cosine / sine - HIGHEST_RATIO < 6e-4


@pytest.mark.parametrize("ratio", [0.5621001, 1.7789999])
def test_pairs_just_inside_the_limits_exist(ratio: float) -> None:
    """Protects the whole admissible range, where the shorter part turns by less than a milliradian."""
    curve = ClothoidPair(0.025, 0.025 * ratio).curve
    end = [jet.value[0] for jet in curve.jets(curve.length, 6)]
    np.testing.assert_allclose(end, [0.025 * ratio, 0.025], rtol=1e-14)
    assert all(np.all(np.isfinite(jet.coefficients)) for jet in curve.jets(np.linspace(0.0, curve.length, 50), 6))

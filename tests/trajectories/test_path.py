"""Paths, their blends and arc lengths: closed forms, quadrature, continuity, and roots as scipy finds them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import ellipe, fresnel

from flexfmu.trajectories.curves import tabulate
from flexfmu.trajectories.jets import Jet, RealArray, arctan2, sqrt
from flexfmu.trajectories.path import (
    HIGHEST_RATIO,
    LOWEST_RATIO,
    Blend,
    ClothoidPair,
    LameBlend,
    PickAndPlacePath,
    PolarPolynomial,
    aspect_ratio,
)
from flexfmu.trajectories.roots import root_between


@pytest.mark.parametrize("seed", range(50))
def test_same_bits_as_scipy(seed: int) -> None:
    """Brent's method, for smooth functions, steep and flat ones, and tolerances from coarse to rounding."""
    rng = np.random.default_rng(seed)
    at, slope, bend = rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(-6.0, 6.0), rng.uniform(-0.2, 0.2)
    functions = (
        lambda x: slope * (x - at) * (1.0 + bend * x),
        lambda x: math.expm1(3.0 * (x - at)) + bend * (x - at) ** 3,
        lambda x: (x - at) ** 3 + 0.01 * (x - at),
        lambda x: math.copysign(slope, x - at),
        lambda x: math.atan(slope * (x - at)),
    )
    low, high = at - rng.uniform(0.1, 2.0), at + rng.uniform(0.1, 2.0)
    absolute = 10.0 ** rng.uniform(-17.0, -3.0)
    for function in functions:
        expected = brentq(function, low, high, xtol=absolute, rtol=1e-15)
        assert root_between(function, low, high, absolute=absolute, relative=1e-15) == expected


def test_ends() -> None:
    """An end at which the function is zero is the root; without a change of sign there need not be one; and interpolation crawls
    towards a root of high multiplicity, as scipy's does."""
    assert root_between(lambda x: x * x, 0.0, 1.0) == 0.0
    assert root_between(lambda x: x - 1.0, 0.0, 1.0) == 1.0
    with pytest.raises(ValueError, match="same sign at 1 and at 2: 1 and 4"):
        root_between(lambda x: x * x, 1.0, 2.0)
    with pytest.raises(RuntimeError, match="after 100 steps"):
        root_between(lambda x: (x - 0.3) ** 9, -1.0, 1.0, absolute=1e-17)


def ellipse_speed(a: float, b: float):
    """Speed of (a cos u, b sin u)."""
    return lambda u: np.hypot(a * np.sin(u), b * np.cos(u))


@pytest.mark.parametrize("ratio", [1.0, 1.5, 7.0, 40.0, 1e3, 1e6])
def test_quarter_ellipse(ratio: float) -> None:
    """Protects the quadrature, also where the speed varies by orders of magnitude: a complete elliptic integral."""
    table = tabulate(ellipse_speed(ratio, 1.0), 0.5 * math.pi)
    assert table.length == pytest.approx(ratio * ellipe(1.0 - ratio**-2), rel=2e-15)


@pytest.mark.parametrize("rate", [1e-3, 1.0, 3.0])
def test_inverse_is_exact(rate: float) -> None:
    """Protects Newton's method: for s = k (e^(k u) - 1) the parameter is a logarithm; 4e-15 is 9 ulp of its range."""
    table = tabulate(lambda u: rate**2 * np.exp(rate * u), 2.0)
    s = np.linspace(0.0, table.length, 10_001)
    np.testing.assert_allclose(table.parameter(s), np.log1p(s / rate) / rate, rtol=0, atol=4e-15)


def test_arc_lengths_beyond_the_ends_stay_on_the_curve() -> None:
    """Protects the ends against rounding in the arc length of a motion."""
    table = tabulate(ellipse_speed(1.0, 1.0), 1.0)
    u = table.parameter(np.array([-1e-15, 1.0 + 1e-15]))
    assert 0.0 <= u.min() <= u.max() <= 1.0
    np.testing.assert_allclose(u, [0.0, 1.0], rtol=0, atol=4e-16)


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


@st.composite
def paths(draw: st.DrawFn) -> PickAndPlacePath:
    """A feasible path in any direction, with and without straight parts."""
    kind = draw(st.sampled_from([LameBlend, ClothoidPair, PolarPolynomial]))
    blend = kind(draw(st.floats(0.01, 0.05)), 0.0 + draw(st.floats(0.01, 0.05))) if kind is not ClothoidPair else None
    if blend is None:
        height = draw(st.floats(0.01, 0.05))
        blend = ClothoidPair(height, height * draw(st.floats(0.5622, 1.7789)))
    room = st.one_of(st.just(0.0), st.floats(1e-6, 0.3))
    angle = draw(st.floats(-math.pi, math.pi))
    lift = (math.cos(angle), math.sin(angle))
    start = (draw(st.floats(-1.0, 1.0)), draw(st.floats(-1.0, 1.0)))
    return PickAndPlacePath(start, lift, blend.height + draw(room), 2.0 * blend.width + draw(room), blend)


@settings(max_examples=60)
@given(paths())
def test_path_leads_smoothly_to_its_end(path: PickAndPlacePath) -> None:
    """Protects ends, and position, tangent and curvature at every knot, for any direction and size."""
    size = path.height + path.width
    ends = np.stack([jet.value for jet in path.jets([0.0, path.length], 0)])
    across = np.array(path.crossing_direction)
    np.testing.assert_allclose(ends[:, 0], path.start, rtol=0, atol=4e-16)
    np.testing.assert_allclose(ends[:, 1], path.end, rtol=0, atol=1e-15)
    np.testing.assert_allclose(path.end, np.array(path.start) + path.width * across, rtol=0, atol=4e-16)
    left, right = (np.stack([j.derivatives() for j in path.jets(path.knots, 2, side)]) for side in ("left", "right"))
    np.testing.assert_allclose(left[:, 0], right[:, 0], rtol=0, atol=2e-15 + 1e-15 * size)
    np.testing.assert_allclose(left[:, 1], right[:, 1], rtol=0, atol=1e-13)
    np.testing.assert_allclose(left[:, 2], right[:, 2], rtol=0, atol=1e-8)


@settings(max_examples=60)
@given(paths())
def test_path_starts_along_the_lift_and_comes_back_along_it(path: PickAndPlacePath) -> None:
    """Protects directions: up, across and down, symmetric about the middle."""
    s = np.linspace(0.0, path.length, 101)
    points, tangents = np.stack([jet.derivatives() for jet in path.jets(s, 1)], axis=-1)
    lift, across = np.array(path.lift_direction), np.array(path.crossing_direction)
    np.testing.assert_allclose(tangents[0], lift, rtol=0, atol=1e-13)
    np.testing.assert_allclose(tangents[-1], -lift, rtol=0, atol=1e-13)
    height, width = (points - path.start) @ lift, (points - path.start) @ across
    assert height.max() == pytest.approx(path.height, rel=1e-2)
    np.testing.assert_allclose(height, height[::-1], rtol=0, atol=3e-15)
    np.testing.assert_allclose(width + width[::-1], path.width, rtol=0, atol=3e-15)
    assert np.all(np.diff(width) >= -1e-15)


@pytest.mark.parametrize(
    ("lift", "crossing"),
    [
        ((0.0, -1.0), (1.0, 0.0)),
        ((0.0, 2.5), (1.0, 0.0)),
        ((1.0, 0.0), (0.0, 1.0)),
        ((-3.0, 0.0), (0.0, 1.0)),
        ((math.cos(math.pi), math.sin(math.pi)), (0.0, 1.0)),
        ((1.0, -1e-17), (0.0, 1.0)),
        ((3.0, 4.0), (0.8, -0.6)),
        ((-3.0, 4.0), (0.8, 0.6)),
        ((3.0, -4.0), (0.8, 0.6)),
        ((-3e200, -4e200), (0.8, -0.6)),
        ((3e-300, 4e-300), (0.8, -0.6)),
    ],
)
def test_crossing_is_perpendicular_towards_positive_x(lift: tuple[float, float], crossing: tuple[float, float]) -> None:
    """Protects the rule of the scene file; the lift's length doesn't matter, a lift along x crosses along +y."""
    path = PickAndPlacePath((0.0, 0.0), lift, 0.025, 0.35, LameBlend(0.025, 0.025))
    np.testing.assert_allclose(path.crossing_direction, crossing, rtol=0, atol=2e-16)
    assert math.hypot(*path.lift_direction) == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize(
    ("height", "blend", "knots"),
    [
        (0.025, LameBlend(0.025, 0.025), 2),
        (0.040, LameBlend(0.025, 0.025), 4),
        (0.025, LameBlend(0.025, 0.175), 1),
        (0.040, LameBlend(0.025, 0.175), 3),
        (0.025, ClothoidPair(0.025, 0.025), 4),
        (0.040, ClothoidPair(0.025, 0.025), 6),
        (0.100, ClothoidPair(0.1, 0.175), 3),
        (0.040, PolarPolynomial(0.02, 0.03), 4),
    ],
)
def test_knots_are_where_derivatives_jump(height: float, blend: Blend, knots: int) -> None:
    """Protects the breakpoints: parts of no length leave none, clothoid pairs have one in their middle."""
    path = PickAndPlacePath((0.0, 0.0), (0.0, 1.0), height, 0.35, blend)
    straight = 2.0 * (height - blend.height) + 0.35 - 2.0 * blend.width
    assert len(path.knots) == knots
    assert path.length == pytest.approx(2.0 * blend.curve.length + straight, rel=1e-15)
    left, right = (np.stack([j.derivatives() for j in path.jets(path.knots, 4, side)]) for side in ("left", "right"))
    jump = np.abs(left - right)[:, 3:].max(axis=(0, 1))
    assert np.all(jump > 1.0)


def test_blend_up_to_half_the_width_despite_rounding() -> None:
    """Protects e = width/2 when the two come from different sums."""
    path = PickAndPlacePath((0.0, 0.0), (0.0, 1.0), 0.1 + 0.2, 0.7, LameBlend(0.3, (0.1 + 0.2 + 0.05) * (1 + 1e-15)))
    assert len(path.knots) == 1

"""The pick-and-place path: directions, parts, knots and continuity."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.trajectories.path import Blend, ClothoidPair, LameBlend, PickAndPlacePath, PolarPolynomial

seeded = settings(max_examples=60)


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


@seeded
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


@seeded
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

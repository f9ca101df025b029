"""The clothoid pair: curvature linear in arc length, and the limits of its aspect ratio."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import fresnel

from flexfmu.trajectories import ClothoidPair, TrajectoryError
from flexfmu.trajectories.blends import HIGHEST_RATIO, LOWEST_RATIO, aspect_ratio

seeded = settings(derandomize=True, deadline=None, max_examples=40)


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


@seeded
@given(st.floats(0.5622, 1.7789))
def test_parts_join_smoothly(ratio: float) -> None:
    """Protects position, tangent and curvature where the two clothoids meet; their jerk jumps there."""
    curve = ClothoidPair(1.0, ratio).curve
    knot = curve.knots[0]
    left, right = (
        np.array([jet.derivatives()[:, 0] for jet in curve.jets(knot, 3, side)]) for side in ("left", "right")
    )
    np.testing.assert_allclose(left[:, 0], right[:, 0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(left[:, 1:3], right[:, 1:3], rtol=0, atol=1e-13)
    assert np.abs(left[:, 3] - right[:, 3]).max() > 1.0


def test_equal_extents_turn_by_equal_angles() -> None:
    """Protects the symmetric pair of the paper."""
    assert ClothoidPair(0.025, 0.025).first_turning == pytest.approx(math.pi / 4, rel=1e-15)


def test_limits_of_the_ratio_follow_from_a_single_clothoid() -> None:
    """Protects the limits: where one part vanishes e/d is a ratio of Fresnel integrals at 1, just beyond the limits."""
    sine, cosine = fresnel(1.0)
    assert aspect_ratio(0.0) == pytest.approx(cosine / sine, rel=1e-15)
    assert aspect_ratio(0.5 * math.pi) == pytest.approx(sine / cosine, rel=1e-15)
    assert 0.0 < LOWEST_RATIO - sine / cosine < 2e-4
    assert 0.0 < cosine / sine - HIGHEST_RATIO < 6e-4


def test_ratio_falls_monotonically() -> None:
    """Protects the uniqueness of the pair for a given ratio."""
    assert np.all(np.diff([aspect_ratio(turning) for turning in np.linspace(0.0, 0.5 * math.pi, 200)]) < 0.0)


@pytest.mark.parametrize("ratio", [0.5621001, 1.7789999])
def test_pairs_just_inside_the_limits_exist(ratio: float) -> None:
    """Protects the whole admissible range, where the shorter part turns by less than a milliradian."""
    curve = ClothoidPair(0.025, 0.025 * ratio).curve
    end = [jet.value[0] for jet in curve.jets(curve.length, 6)]
    np.testing.assert_allclose(end, [0.025 * ratio, 0.025], rtol=1e-14)
    assert all(np.all(np.isfinite(jet.coefficients)) for jet in curve.jets(np.linspace(0.0, curve.length, 50), 6))


@pytest.mark.parametrize("ratio", [0.1, 0.5620, 1.7791, 5.0])
def test_ratios_outside_the_limits_are_refused(ratio: float) -> None:
    """Protects against a pair that doesn't exist; the message tells limits, values and what to choose."""
    message = (
        rf"needs 0\.5621 < e/d < 1\.7790, got e/d = {ratio:.6g} \(e = {0.025 * ratio:g} m, d = 0\.025 m\); "
        r"for d = 0\.025 m choose e between 0\.0140525 m and 0\.044475 m"
    )
    with pytest.raises(TrajectoryError, match=message):
        ClothoidPair(0.025, 0.025 * ratio)

"""Distances to outlines agree with closed forms, in value and gradient; what a motion clears is the region that it goes around."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.cosim.choices.plans.clearance import Clearance, Polygon, clearance_of_trace

RANDOM = np.random.default_rng(16)
POINTS = RANDOM.uniform(-2.0, 2.0, (2000, 2))


def test_distance_to_a_rectangle_is_the_closed_form() -> None:
    distance, _ = Polygon.of([(0, 0), (1, 0), (1, 2), (0, 2)]).distance(POINTS)
    beyond = np.abs(POINTS - [0.5, 1.0]) - [0.5, 1.0]
    exact = np.hypot(*np.maximum(beyond, 0.0).T) + np.minimum(beyond.max(axis=1), 0.0)
    assert distance == pytest.approx(exact, abs=1e-14)


def test_distance_to_a_circle_of_many_corners_is_the_radius_left() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    distance, gradient = Polygon.of(np.column_stack([np.cos(angle), np.sin(angle)])).distance(POINTS)
    radius = np.hypot(*POINTS.T)
    # the sagitta of its sides, and half the angle between them
    assert np.abs(distance - (radius - 1.0)).max() < (np.pi / 400) ** 2 / 2 * 1.01
    assert np.abs(gradient - POINTS / radius[:, None]).max() < np.pi / 400


def test_a_reflex_corner_belongs_to_the_right_side() -> None:
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    x, y = POINTS.T
    inside = (x > 0) & (y > 0) & (x < 2) & (y < 2) & ~((x > 1) & (y > 1))
    assert ((Polygon.of(outline).distance(POINTS)[0] < 0.0) == inside).all()
    # the sense of rotation doesn't matter
    assert ((Polygon.of(outline[::-1]).distance(POINTS)[0] < 0.0) == inside).all()


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=3, max_size=3), st.integers(0, 1000))
def test_gradient_is_the_slope_of_the_distance(corners: list[tuple[float, float]], seed: int) -> None:
    (x1, y1), (x2, y2), (x3, y3) = corners
    if abs((x2 - x1) * (y3 - y1) - (x3 - x1) * (y2 - y1)) < 1e-2:
        return
    polygon, point = Polygon.of(corners), np.random.default_rng(seed).uniform(-3, 3, (1, 2))
    gradient = polygon.distance(point)[1]
    step = 1e-7
    slope = [
        (polygon.distance(point + step * e)[0] - polygon.distance(point - step * e)[0])[0] / (2 * step)
        for e in np.eye(2)
    ]
    # but where two sides are equally near
    nearest = np.hypot(*slope)
    if abs(nearest - 1.0) < 1e-4:
        assert gradient[0] == pytest.approx(slope, abs=1e-4)


def test_a_motion_clears_what_it_goes_around() -> None:
    across = np.linspace(0.0, 0.3, 301)
    trace = np.column_stack([across, 0.05 * np.sin(np.pi * across / 0.3)])
    clearance = clearance_of_trace(trace, corridor=0.01, below=1e-3)
    allowed = [[0.15, 0.055], [-0.005, 0.001], [0.305, 0.02], [0.15, 0.0599]]
    kept_clear = [[0.15, 0.04], [0.15, 0.065], [-0.02, 0.001], [0.32, 0.02], [0.15, -0.002]]
    assert (clearance.distance(np.array(allowed)) > 0.0).all()
    assert (clearance.distance(np.array(kept_clear)) < 0.0).all()


def test_without_regions_everything_is_allowed() -> None:
    nothing = Clearance((), np.empty((0, 2)), np.empty((0, 2)))
    assert np.isinf(nothing.distance(POINTS)).all()

"""Splines against polynomials that they must reproduce, their continuity and their order of convergence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexfmu.trajectories.piecewise import DEGREES, PiecewisePolynomial, spline

SPLINES = [(degree, order) for degree in DEGREES for order in range(degree // 2 + 1)]
"""Degree, and highest order of given derivatives."""


def rest_to_rest(order: int) -> np.polynomial.Polynomial:
    """The polynomial of degree 2 order + 1 from 0 to 1 whose derivatives up to ``order`` vanish at both ends."""
    rate = np.polynomial.Polynomial([0.0, 1.0, -1.0]) ** order
    return rate.integ() / rate.integ()(1.0)


def derivatives(polynomial: np.polynomial.Polynomial, time: np.ndarray, order: int) -> np.ndarray:
    """The polynomial p and -3 p + 1 with derivatives, (order + 1, N, 2)."""
    rows = np.array([polynomial.deriv(k)(time) for k in range(order + 1)])
    second = -3.0 * rows
    second[0] += 1.0
    return np.stack([rows, second], axis=-1)


def uneven(count: int, seed: int = 1) -> np.ndarray:
    """Times from 0 to 1 whose steps differ by up to a factor of three."""
    steps = np.random.default_rng(seed).uniform(0.5, 1.5, count - 1)
    return np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()


@pytest.mark.parametrize(("degree", "order"), SPLINES)
def test_a_polynomial_of_its_degree_is_reproduced(degree: int, order: int) -> None:
    """With all derivatives, and through the end conditions of rest also without them."""
    polynomial, time = rest_to_rest(degree // 2), uneven(12)
    found = spline(time, derivatives(polynomial, time, order), degree)
    instants = np.linspace(0.0, 1.0, 301)[1:-1]
    expected = derivatives(polynomial, instants, degree)
    np.testing.assert_allclose(found.evaluate(instants, 2), expected[:3], atol=1e-10)
    assert abs(found.evaluate(instants, degree + 2)[degree + 1 :]).max() == 0.0


@pytest.mark.parametrize(("degree", "order"), SPLINES)
def test_as_often_differentiable_as_stated(degree: int, order: int) -> None:
    """``degree`` - 1 - m derivatives are continuous at each knot, the next one jumps there."""
    time = uneven(9)
    values = derivatives(np.polynomial.Polynomial([0.0]), time, order)
    values[0, :, 0] = np.sin(7.0 * time)
    values[1:, 1:-1, 0] = np.random.default_rng(3).normal(size=(order, 7))
    found, continuity = spline(time, values, degree), degree - 1 - order
    left, right = (found.evaluate(time[1:-1], degree, side) for side in ("left", "right"))
    jumps = abs(left - right)[:, :, 0].max(axis=1) / abs(right[:, :, 0]).max(axis=1)
    assert jumps[: continuity + 1].max() < 1e-9 < 1e-3 < jumps[continuity + 1]
    assert found.breakpoints == pytest.approx(tuple(time))


@pytest.mark.parametrize("degree", DEGREES)
def test_converges_with_its_degree_plus_one(degree: int) -> None:
    """Position alone, through a motion with so many derivatives zero at its ends that the end conditions hold."""
    instants, errors = np.linspace(0.0, 1.0, 500), []
    for count in (33, 65):
        time = np.linspace(0.0, 1.0, count)
        there_and_back = np.sin(np.pi * time) ** 10
        found = spline(time, np.column_stack([there_and_back, there_and_back])[np.newaxis], degree)
        errors.append(abs(found.evaluate(instants, 0)[0, :, 0] - np.sin(np.pi * instants) ** 10).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(degree + 1, abs=0.6)


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=8), st.floats(0.1, 10.0))
def test_scaled_in_time(values: list[float], duration: float) -> None:
    """A motion that takes c times as long has derivatives that are smaller by powers of c."""
    positions = np.column_stack([values, values[::-1]])[np.newaxis]
    motion = spline(np.arange(len(values)), positions)
    slower, pace = motion.with_duration(duration), motion.duration / duration
    instants = np.linspace(0.0, duration, 23)
    assert slower.duration == duration
    for order, row in enumerate(slower.evaluate(instants, 3, "left")):
        expected = motion.evaluate(instants * pace, 3, "left")[order] * pace**order
        np.testing.assert_allclose(row, expected, rtol=1e-9, atol=1e-9 * max(1.0, pace**order) * 10.0)


def test_stands_still_before_and_after() -> None:
    """Also at the outer limits of start and end, with a velocity that would run on."""
    motion = PiecewisePolynomial(np.array([0.0, 2.0]), np.array([[[1.0, 0.0]], [[0.5, 0.0]], [[1.0, 1.0]]]))
    before, after = motion.evaluate([-1.0], 2)[:, 0], motion.evaluate([3.0], 2)[:, 0]
    np.testing.assert_array_equal(before, [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(after, [[6.0, 4.0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(motion.evaluate([0.0], 2, "left")[1:], 0.0)
    np.testing.assert_array_equal(motion.evaluate([2.0], 2, "right")[:, 0], after)
    assert motion.evaluate([2.0], 1, "left")[1, 0] == pytest.approx([4.5, 4.0])


def test_no_breakpoint_where_nothing_jumps() -> None:
    """A knot within a polynomial, or within standstill, is none."""
    taylor = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 2.0]])
    later = np.array([[0.25, 0.5], [1.0, 2.0], [1.0, 2.0]])
    still = np.array([[1.0, 2.0], [0.0, 0.0], [0.0, 0.0]])
    coefficients = np.stack([taylor, later, still, still], axis=1)
    motion = PiecewisePolynomial(np.array([0.0, 0.5, 1.0, 2.0, 3.0]), coefficients)
    assert motion.breakpoints == (0.0, 1.0, 3.0)

"""Values between communication points: exact for polynomials, with both sides of every jump."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from flexfmu.cosim.engine.dense_output import DenseOutput, integral, resampled
from flexfmu.cosim.engine.hermite import hermite_derivatives
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray

POINTS = np.array([0.0, 0.1, 0.15, 0.4, 0.5, 0.7, 0.7, 0.8, 0.95, 1.2, 1.25, 1.4])
"""Communication points with a jump."""

INSTANTS = np.append(np.arange(0.0, 1.4, 0.03), 0.5)
"""One of them is a communication point."""


def signals(degree: int, count: int = 3) -> list[Polynomial]:
    """Polynomials with coefficients of one size."""
    return [Polynomial(row) for row in np.random.default_rng(degree).normal(size=(count, degree + 1))]


def column(signal: Polynomial, time: RealArray) -> Column:
    """The signal with two derivatives."""
    return Column("m", signal(time), signal.deriv(1)(time), signal.deriv(2)(time))


def test_polynomials_are_exact() -> None:
    """Up to degree 11, with their derivatives, at all instants and both sides of the jump."""
    dense = DenseOutput(POINTS, np.sort(INSTANTS), 4)
    assert np.count_nonzero(np.diff(dense.time) == 0.0) == 1
    assert {*np.round(INSTANTS, 9)} <= {*np.round(dense.time, 9)}
    for degree in (0, 5, 8, 11):
        several = signals(degree)
        known = np.array([[signal.deriv(k)(POINTS) if k else signal(POINTS) for k in range(3)] for signal in several])
        for signal, rows in zip(several, known, strict=True):
            for k, found in enumerate(dense.of(rows, np.array([[0, 1, 0, 1, 0]]), 3)[0]):
                expected = signal.deriv(k)(dense.time) if k else signal(dense.time)
                np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-6)


def test_jumps_have_both_limits() -> None:
    """Nothing is interpolated across a jump."""
    jumps = np.arange(POINTS.size) > 5
    one, other = signals(7, 2)
    values = [np.where(jumps, *(s.deriv(k)(POINTS) if k else s(POINTS) for s in (other, one))) for k in range(3)]
    found = resampled(Recording(POINTS, {"y": Column("m", *values)}), DenseOutput(POINTS, np.sort(INSTANTS), 4), 1)
    left = np.flatnonzero(np.diff(found.time) == 0.0)[0] + 1
    for part, signal in ((slice(0, left), one), (slice(left, None), other)):
        np.testing.assert_allclose(found["y"].values[part], signal(found.time[part]), rtol=1e-8, atol=1e-8)
    assert found["y"].second is None


def test_derivatives_follow_their_signal() -> None:
    """``der(x)`` is the derivative of the interpolant of ``x``: noise in its own derivatives matters at the points alone."""
    (x,) = signals(9, 1)
    rate, acceleration = column(x.deriv(), POINTS), column(x.deriv(2), POINTS)
    noisy = {
        "der(x)": rate,
        "der(x,2)": Column("m", acceleration.values, np.full(POINTS.size, 1e9), acceleration.second),
    }
    found = resampled(
        Recording(POINTS, {"x": column(x, POINTS), **noisy}), DenseOutput(POINTS, np.sort(INSTANTS), 4), 2
    )
    for name, k in (("x", 0), ("der(x)", 1), ("der(x,2)", 2)):
        expected = (x.deriv(k) if k else x)(found.time)
        np.testing.assert_allclose(found[name].values, expected, rtol=1e-6, atol=1e-5)
    assert integral("plant.der(link11.bending[1],2)") == ("plant.link11.bending[1]", 2)
    assert integral("plant.joint1.torque") is None
    # without the signal they are interpolated by themselves
    alone = resampled(Recording(POINTS, {"der(x)": rate}), DenseOutput(POINTS, np.sort(INSTANTS), 4), 0)
    np.testing.assert_allclose(alone["der(x)"].values, x.deriv()(alone.time), rtol=1e-7, atol=1e-6)


def test_signals_without_derivatives_are_held() -> None:
    """Their values are those of the last communication point."""
    values = np.arange(POINTS.size, dtype=np.float64)
    found = resampled(Recording(POINTS, {"n": Column("", values)}), DenseOutput(POINTS, np.sort(INSTANTS), 4), 2)
    for time, value in zip(found.time.tolist(), found["n"].values.tolist(), strict=True):
        assert POINTS[int(value)] <= time + 1e-12


@pytest.mark.parametrize("size", [2, 3, 4])
def test_short_recordings(size: int) -> None:
    """A run that has failed early has few points; the degree is what they allow."""
    (signal,) = signals(3 * size - 1, 1)
    points = POINTS[:size]
    found = resampled(Recording(points, {"y": column(signal, points)}), DenseOutput(points, np.sort(INSTANTS), 4), 1)
    assert found.time[-1] == points[-1]
    np.testing.assert_allclose(found["y"].values, signal(found.time), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found["y"].first, signal.deriv()(found.time), rtol=1e-7, atol=1e-7)


def derivatives(coefficients: np.ndarray, x: float, count: int) -> np.ndarray:
    """Value and derivatives of a polynomial."""
    polynomial = np.polynomial.Polynomial(coefficients)
    return np.array([polynomial.deriv(k)(x) if k else polynomial(x) for k in range(count)])


@pytest.mark.parametrize("order", range(6))
def test_reproduces_polynomials_of_its_degree(order: int) -> None:
    """A polynomial of degree 2k + 1 is recovered from its ends: nothing is lost between two communication points."""
    coefficients = np.random.default_rng(order).normal(size=2 * order + 2)
    step = 0.7
    ends = [derivatives(coefficients, x, order + 1)[:, None] for x in (0.0, step)]
    found = hermite_derivatives(*ends, step)[:, 0]
    expected = coefficients * [factorial(k) for k in range(2 * order + 2)]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8 * abs(expected).max())


@pytest.mark.parametrize("step", [1e-7, 2e-4, 1.0])
def test_meets_the_right_end_at_any_step(step: float) -> None:
    """At the end of a step value and derivatives are those asked for, also after steps of a fraction of a microsecond.

    Rounding errors are amplified by the inverse of the end matrix, whose rows add up to as much as 1456.
    """
    rounding = 1456 * np.finfo(float).eps
    t = np.array([0.1, 0.3])
    left, right = (np.array([np.sin(s + k * np.pi / 2) for k in range(5)]) for s in (t, t + step))
    found = hermite_derivatives(left, right, np.full(2, step))
    for k in range(3):
        end = sum(found[j] * step ** (j - k) / factorial(j - k) for j in range(k, 10))
        np.testing.assert_allclose(end, right[k], rtol=0, atol=rounding / step**k)

"""Two-point Hermite polynomials reproduce polynomials and meet both ends."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest

from flexfmu.cosim.engine.hermite import hermite_derivatives


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

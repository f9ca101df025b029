"""Jets against known series and against algebraic identities."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from flexfmu.trajectories.jets import Jet, arctan2, compose, power, revert, sincos, sqrt, stack

ORDER = 12

coefficients = arrays(float, (7, 3), elements=st.floats(-2.0, 2.0))
seeded = settings(max_examples=60)


def variable(value: float = 0.0) -> Jet:
    return Jet.variable(value, ORDER)


@pytest.mark.parametrize(
    ("jet", "series"),
    [
        (1.0 / (1.0 - variable()), [1.0] * (ORDER + 1)),
        (sincos(variable())[0], [math.sin(k * math.pi / 2) / math.factorial(k) for k in range(ORDER + 1)]),
        (sincos(variable())[1], [math.cos(k * math.pi / 2) / math.factorial(k) for k in range(ORDER + 1)]),
        (
            arctan2(variable(), Jet.constant(1.0, ORDER)),
            [math.sin(k * math.pi / 2) / max(k, 1) for k in range(ORDER + 1)],
        ),
        (sqrt(1.0 + 4.0 * variable()), [-((-1) ** k) * math.comb(2 * k, k) / (2 * k - 1) for k in range(ORDER + 1)]),
        (power(1.0 - variable(), -3.0), [math.comb(k + 2, 2) for k in range(ORDER + 1)]),
    ],
)
def test_elementary_functions_have_their_known_series(jet: Jet, series: list[float]) -> None:
    """Protects each recurrence against the textbook's Taylor series."""
    np.testing.assert_allclose(jet.coefficients, series, rtol=1e-13, atol=1e-15)


@seeded
@given(coefficients, coefficients)
def test_product_is_the_truncated_product_of_polynomials(a: np.ndarray, b: np.ndarray) -> None:
    """Protects multiplication, order by order and point by point."""
    product = (Jet(a) * Jet(b)).coefficients
    expected = np.stack([np.convolve(a[:, i], b[:, i])[:7] for i in range(3)], axis=1)
    np.testing.assert_allclose(product, expected, rtol=0, atol=1e-13)


@seeded
@given(coefficients, coefficients)
def test_division_undoes_multiplication(a: np.ndarray, b: np.ndarray) -> None:
    """Protects division, for denominators well away from zero."""
    denominator = Jet(0.2 * b) + 2.0
    np.testing.assert_allclose((Jet(a) * denominator / denominator).coefficients, a, rtol=0, atol=1e-12)


@seeded
@given(coefficients)
def test_roots_and_powers_agree(a: np.ndarray) -> None:
    """Protects the root and the real power: (√u)² = u, u^½ = √u and u^(-1/3) cubed times u is 1."""
    u = Jet(0.3 * a) + 2.0
    root, third = sqrt(u), power(u, -1.0 / 3.0)
    np.testing.assert_allclose((root * root).coefficients, u.coefficients, rtol=0, atol=1e-12)
    np.testing.assert_allclose(power(u, 0.5).coefficients, root.coefficients, rtol=0, atol=1e-12)
    np.testing.assert_allclose((third * third * third * u - 1.0).coefficients, 0.0, atol=1e-12)


@seeded
@given(coefficients, coefficients)
def test_composition_is_associative_with_multiplication(a: np.ndarray, b: np.ndarray) -> None:
    """Protects composition: (f g)∘h = (f∘h)(g∘h), and the stacked form agrees with the single one."""
    inner = Jet(0.5 * b)
    f, g = Jet(a), Jet(a[::-1])
    np.testing.assert_allclose(
        compose(f * g, inner).coefficients, (compose(f, inner) * compose(g, inner)).coefficients, rtol=1e-10, atol=1e-9
    )
    both = compose(stack((f, g)), inner).coefficients
    np.testing.assert_array_equal(both[:, 1], compose(g, inner).coefficients)


def test_composition_with_the_reversion_is_the_identity() -> None:
    """Protects reversion for many points at once: s(u(s)) = s."""
    u = Jet.variable(np.linspace(0.5, 2.0, 9), 8)
    s = u + 0.3 * sincos(u)[0]
    identity = compose(s, revert(s))
    np.testing.assert_allclose(identity.coefficients[1], 1.0, rtol=1e-14)
    np.testing.assert_allclose(identity.coefficients[2:], 0.0, atol=1e-13)


def test_derivatives_are_unnormalised() -> None:
    """Protects the factorials between Taylor coefficients and derivatives, in both directions."""
    derivatives = np.array([[2.0], [3.0], [4.0], [5.0]])
    jet = Jet.from_derivatives(derivatives)
    np.testing.assert_allclose(jet.coefficients[:, 0], [2.0, 3.0, 2.0, 5.0 / 6.0])
    np.testing.assert_allclose(jet.derivatives(), derivatives)
    np.testing.assert_allclose(jet.differentiate().derivatives(), derivatives[1:])
    np.testing.assert_allclose(jet.differentiate().integrate(2.0).derivatives(), derivatives)
    np.testing.assert_allclose(jet.rescale(-2.0).derivatives()[:, 0], [2.0, -6.0, 16.0, -40.0])


def test_numbers_and_arrays_are_constants_on_either_side() -> None:
    """Protects mixed arithmetic, where numpy would otherwise spread a jet over an array's elements; the lower order and the common
    shape win: no coefficient is invented."""
    value, wide = np.array([1.0, 2.0]), np.array([[1.0, 3.0], [4.0, 5.0]])
    jet = Jet.variable(value, 2)
    for result, expected in (
        (value * jet, [value**2, value, [0, 0]]),
        (value - jet, [[0, 0], [-1, -1], [0, 0]]),
        (np.float64(2.0) + jet, [value + 2.0, [1, 1], [0, 0]]),
        (jet / 2.0, [value / 2.0, [0.5, 0.5], [0, 0]]),
        (1.0 / jet, [1 / value, -1 / value**2, 1 / value**3]),
        (wide - jet, [wide - value, np.full((2, 2), -1.0), np.zeros((2, 2))]),
        (jet * wide, [value * wide, wide, np.zeros((2, 2))]),
        (jet / Jet.variable(2.0, 5), [value / 2.0, 0.5 - value / 4.0, value / 8.0 - 0.25]),
        (Jet.variable(wide, 5) + jet, [wide + value, np.full((2, 2), 2.0), np.zeros((2, 2))]),
    ):
        assert isinstance(result, Jet)
        np.testing.assert_allclose(result.coefficients, expected)


def test_square_root_of_zero_is_zero_without_derivatives() -> None:
    """Protects values at a workspace boundary, where only the derivatives are infinite."""
    assert sqrt(Jet.constant(0.0, 0)).value == 0.0

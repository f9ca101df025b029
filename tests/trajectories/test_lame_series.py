"""Arc-length derivatives of the Lamé curve at its ends against exact rational series, which share no code with jets."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import pytest

from flexfmu.trajectories.blends import LameBlend

Series = list[Fraction]

ORDER = 10


def product(a: Sequence[Fraction], b: Sequence[Fraction]) -> Series:
    """Product, truncated to the common length."""
    return [sum((a[j] * b[k - j] for j in range(k + 1)), Fraction(0)) for k in range(len(a))]


def power(a: Sequence[Fraction], exponent: Fraction) -> Series:
    """a^exponent for a series with the constant term 1, by the binomial series."""
    rest = [Fraction(0), *a[1:]]
    result, term = [Fraction(0)] * len(a), [Fraction(k == 0) for k in range(len(a))]
    for k in range(len(a)):
        result = [r + t for r, t in zip(result, term, strict=True)]
        term = [t * (exponent - k) / (k + 1) for t in product(term, rest)]
    return result


def composition(outer: Sequence[Fraction], inner: Sequence[Fraction]) -> Series:
    """outer(inner) for an inner series without a constant term."""
    result = [Fraction(0)] * len(inner)
    for coefficient in reversed(outer):
        result = product(result, inner)
        result[0] += coefficient
    return result


def inverse(a: Sequence[Fraction]) -> Series:
    """Inverse function of a series x + ..., one coefficient after the other."""
    result = [Fraction(k == 1) for k in range(len(a))]
    for k in range(2, len(a)):
        result[k] -= composition(a, result)[k]
    return result


def lame_start(width: Fraction) -> tuple[list[float], list[float]]:
    """Series of x(s), y(s) about the start of ((e - x)/e)³ + y³ = 1: x = e (1 - (1 - y³)^(1/3))."""
    count = ORDER + 2
    root = power([Fraction(k == 0) - (k == 3) for k in range(count)], Fraction(1, 3))
    x = [width * ((k == 0) - c) for k, c in enumerate(root)]
    slope = [k * x[k] for k in range(1, count)]
    speed = power([Fraction(k == 0) + c for k, c in enumerate(product(slope, slope))], Fraction(1, 2))
    y = inverse([Fraction(0), *(c / (k + 1) for k, c in enumerate(speed))])
    return [float(c) for c in composition(x, y)[: ORDER + 1]], [float(c) for c in y[: ORDER + 1]]


@pytest.mark.parametrize("width", [Fraction(1), Fraction(7), Fraction(89, 50), Fraction(2, 5)])
def test_derivatives_at_both_ends_to_order_ten(width: Fraction) -> None:
    """Protects the one-sided derivatives where the usual parametrisations of Lamé curves have fractional powers."""
    curve = LameBlend(1.0, float(width)).curve
    x, y = (jet.coefficients for jet in curve.jets([0.0, curve.length], ORDER))
    orders = np.arange(ORDER + 1)
    x_start, y_start = lame_start(width)
    # from the end, backwards and in units of e, the curve is a Lamé curve of width 1/e
    units = float(width) ** (1.0 - orders) * (-1.0) ** orders
    y_end, x_end = (units * np.array(series) for series in lame_start(1 / width))
    one = np.eye(1, ORDER + 1)[0]
    for found, expected in (
        ((x[:, 0], y[:, 0]), (x_start, y_start)),
        ((x[:, 1], y[:, 1]), (float(width) * one - x_end, one - y_end)),
    ):
        growth = max(abs(c) ** (1.0 / k) for series in expected for k, c in enumerate(series) if k > 0)
        np.testing.assert_allclose(found / growth**orders, expected / growth**orders, rtol=0, atol=1e-14)

"""Within one unit of the last place of mpmath's 60 digits, everywhere; C99's annex F at the ends."""

from __future__ import annotations

import math
import os

import mpmath
import numpy as np
import pytest
from elementary_support.arguments import NAMES, PAIR_RANGES, calls_of, special_calls
from elementary_support.probe import Array, Call, Evaluate

COUNT = int(os.environ.get("FLEXFMU_ELEMENTARY", "300"))
"""Arguments drawn for each function: a thousand times as many were tried."""

MOST_ULPS = {"sin": 0.85, "cos": 0.85, "tan": 0.99, "floor": 0.0, "ceil": 0.0, "fmod": 0.0, "remainder": 0.0}
"""The largest error that the error analysis of each function admits; of all the others it is this:"""
OTHERS = 0.54
DIGITS = 60
EXACT = {"fmod": math.fmod, "remainder": math.remainder, "floor": math.floor, "ceil": math.ceil}


def _exact(call: Call) -> object:
    """The value in many digits; None where it isn't a real number."""
    name, x, y = call
    if name in EXACT:
        return EXACT[name](x, y) if name in ("fmod", "remainder") else mpmath.mpf(EXACT[name](x))
    if name == "pow" and abs(y * math.log(abs(x))) > 800.0 and (x > 0.0 or y % 2.0 == 0.0):
        return mpmath.mpf(2) ** (2000 if (y > 0) == (abs(x) > 1) else -2000)
    if name == "pow" and x < 0.0 and y % 1.0 != 0.0:
        return None
    if name in ("exp", "expm1", "sinh", "cosh") and abs(x) > 800.0:
        large = mpmath.exp(800)
        return {"exp": large if x > 0 else 1 / large, "expm1": large if x > 0 else -1, "cosh": large}.get(
            name, math.copysign(1.0, x) * large
        )
    function = {"pow": mpmath.power}.get(name) or getattr(mpmath, name)
    value = function(x, y) if name in PAIR_RANGES else function(x)
    return value if isinstance(value, mpmath.mpf) else None


def _ulps(got: float, exact: object) -> float:
    """Difference in units of the last place of the exact value."""
    if exact is None:
        return 0.0 if math.isnan(got) else math.inf
    nearest = float(exact)  # type: ignore[arg-type]
    if math.isinf(nearest) or math.isinf(got) or math.isnan(got):
        return 0.0 if got == nearest else math.inf
    return float(abs(mpmath.mpf(got) - exact) / mpmath.mpf(math.ulp(nearest)))


def _errors(calls: list[Call], results: Array) -> list[float]:
    # numbers below the normal ones need 1074 binary digits behind the point, differences from 1 as many
    with mpmath.workdps(DIGITS):
        return [_ulps(float(got), _exact(call)) for call, got in zip(calls, results, strict=True)]


@pytest.mark.parametrize("name", NAMES)
def test_error_is_below_one_unit_of_the_last_place(name: str, evaluate: Evaluate) -> None:
    """Numbers that agree everywhere must be right too."""
    calls = calls_of(name, COUNT, seed=2)
    errors = _errors(calls, evaluate(calls))
    worst = int(np.argmax(errors))
    assert errors[worst] <= MOST_ULPS.get(name, OTHERS), calls[worst]


@pytest.mark.parametrize("name", NAMES)
def test_special_values_are_those_of_the_standard(name: str, evaluate: Evaluate) -> None:
    """Zeros with their signs, infinities and NaN, as Python's and numpy's functions give them."""
    calls = special_calls([name])
    if name in ("sin", "cos", "tan"):
        calls = [call for call in calls if abs(call[1]) != 1e22]
    function = {"erf": np.vectorize(math.erf), "atan2": np.arctan2, "pow": np.vectorize(_power)}.get(name)
    function = function or _numpy_function(name)
    columns = np.array([call[1:] for call in calls])
    with np.errstate(all="ignore"):
        expected = function(*columns.T) if name in PAIR_RANGES else function(columns[:, 0])
    results = evaluate(calls)
    np.testing.assert_allclose(results, expected, rtol=1e-14, atol=0.0, equal_nan=True)
    is_number = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(results[is_number]), np.signbit(expected[is_number]))


def _power(x: float, y: float) -> float:
    """numpy's takes a square root for y = 1/2, which is something else at minus infinity."""
    try:
        return math.pow(x, y)
    except OverflowError:
        return math.copysign(math.inf, x) if y % 2.0 == 1.0 else math.inf
    except ValueError:
        return math.nan if x else math.copysign(math.inf, x) if y % 2.0 == 1.0 else math.inf


def _numpy_function(name: str) -> object:
    if name == "remainder":
        return np.vectorize(lambda x, y: math.remainder(x, y) if math.isfinite(x) and y and y == y else math.nan)
    return getattr(np, name.replace("a", "arc", 1) if name.startswith("a") else name)


def test_sanitizers_find_nothing(evaluate: Evaluate, evaluate_sanitized: Evaluate) -> None:
    """An index beyond a table or an overflowing integer gives right results on one machine and wrong ones on another."""
    calls = [call for name in NAMES for call in calls_of(name, 100, seed=3)] + special_calls(NAMES)
    np.testing.assert_array_equal(evaluate_sanitized(calls), evaluate(calls))


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_lanes_give_the_same_bits(name: str, evaluate: Evaluate) -> None:
    """A step's stages are evaluated side by side on some processors: these must get the numbers of all others."""
    calls = [*calls_of(name, 20 * COUNT, seed=4), *special_calls([name])]
    lanes = evaluate([(f"lanes_{name}", x, y) for _, x, y in calls])
    np.testing.assert_array_equal(lanes.view(np.uint64), evaluate(calls).view(np.uint64))


def test_minimum_and_maximum_tell_zeros_apart(evaluate: Evaluate) -> None:
    """C leaves the order of zeros open, and libraries differ; NaN gives way to a number."""
    calls = [("fmin", 0.0, -0.0), ("fmin", -0.0, 0.0), ("fmax", -0.0, 0.0), ("fmax", 0.0, -0.0)]
    assert [math.copysign(1.0, result) for result in evaluate(calls)] == [-1.0, -1.0, 1.0, 1.0]
    calls = [("fmin", math.nan, 2.0), ("fmin", 2.0, math.nan), ("fmax", math.nan, 2.0), ("fmax", 2.0, math.nan)]
    np.testing.assert_array_equal(evaluate(calls), 2.0)


@pytest.mark.parametrize("exponent", [-2200, -1100, -1074, -1022, -1, 0, 1, 1023, 1100, 2200])
def test_ldexp_rounds_once(exponent: int, evaluate: Evaluate) -> None:
    """Below the normal numbers a second rounding would show."""
    mantissas = [1.0, 1.5, 1.0 + 2.0**-52, -1.9999999, 3.1e-310, 1e300]

    def exact(x: float) -> float:
        try:
            return math.ldexp(x, exponent)
        except OverflowError:
            return math.copysign(math.inf, x)

    np.testing.assert_array_equal(evaluate([("ldexp", x, exponent) for x in mantissas]), [exact(x) for x in mantissas])

"""Arguments at which elementary functions go wrong if they do, and some from everywhere."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Call = tuple[str, float, float]

TINY, HUGE = 5e-324, float(np.finfo(float).max)
SPECIAL = (0.0, -0.0, TINY, -TINY, 2.2250738585072014e-308, 1.0, -1.0, 0.5, 2.0, -3.0, 1e22, HUGE, -HUGE)
WORST_ANGLE = 6381956970095103 * 2.0**797
"""The double that is nearest to a multiple of pi/2, relative to what is left: Muller, Elementary Functions, table 11.1."""

RANGES = {
    **dict.fromkeys(("sin", "cos", "tan"), (-10.0, 10.0)),
    **dict.fromkeys(("asin", "acos", "atanh"), (-1.0, 1.0)),
    **dict.fromkeys(("atan", "sinh", "cosh"), (-5.0, 5.0)),
    **dict.fromkeys(("expm1", "tanh"), (-3.0, 3.0)),
    **dict.fromkeys(("erf", "asinh"), (-4.0, 4.0)),
    **dict.fromkeys(("floor", "ceil"), (-9.0, 9.0)),
    "exp": (-745.0, 709.7),
    "log": (0.0, 4.0),
    "log1p": (-1.0, 3.0),
    "acosh": (1.0, 6.0),
}
"""Function of one argument → where it is used."""

PAIR_RANGES = {
    "atan2": ((-1.0, 1.0), (-1.0, 1.0)),
    "pow": ((0.0, 10.0), (-300.0, 300.0)),
    "hypot": ((-3.0, 3.0), (-3.0, 3.0)),
    "fmod": ((-300.0, 300.0), (-3.0, 3.0)),
    "remainder": ((-300.0, 300.0), (-3.0, 3.0)),
}


NAMES = [*RANGES, *PAIR_RANGES]
"""All functions."""


def calls_of(name: str, count: int, seed: int) -> list[Call]:
    """Finite arguments of a function: where it is used, near zero, of any size, and near multiples of pi/2."""
    random = np.random.default_rng(seed)
    if name in PAIR_RANGES:
        (a, b), (c, d) = PAIR_RANGES[name]
        pairs = np.column_stack([random.uniform(a, b, count), random.uniform(c, d, count)])
        wide = np.column_stack([_of_any_size(random, count // 2), _of_any_size(random, count // 2)])
        return [(name, float(x), float(y)) for x, y in np.vstack([pairs, wide])]
    arguments = [
        random.uniform(*RANGES[name], count),
        _of_any_size(random, count // 2),
        _near_quarters(random, count // 4),
    ]
    small = random.uniform(-1.0, 1.0, count // 4) * 2.0 ** random.uniform(-60.0, 0.0, count // 4)
    start = 1.0 if name == "acosh" else 0.0
    return [(name, float(x), 0.0) for x in np.concatenate([*arguments, start + small, [WORST_ANGLE]])]


def special_calls(names: Sequence[str]) -> list[Call]:
    """Zeros, ones, numbers beyond the normal ones and infinities, in all combinations; NaN too."""
    values = (*SPECIAL, math.inf, -math.inf, math.nan)
    return [(name, x, y) for name in names for x in values for y in (values if name in PAIR_RANGES else (0.0,))]


def _of_any_size(random: np.random.Generator, count: int) -> Array:
    """Of any exponent, numbers below the normal ones included."""
    bits = random.integers(0, 2**64, 2 * count, dtype=np.uint64).view(float)
    return bits[np.isfinite(bits)][:count]


def _near_quarters(random: np.random.Generator, count: int) -> Array:
    """Doubles around k pi/2, k up to a billion."""
    multiples = np.floor(2.0 ** random.uniform(0.0, 30.0, count)) * (math.pi / 2.0)
    return multiples * (1.0 + random.integers(-2, 3, count) * 2.0**-53)

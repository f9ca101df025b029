"""The root finder agrees with scipy's to the last bit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from flexfmu.trajectories.roots import root_between


@pytest.mark.parametrize("seed", range(50))
def test_same_bits_as_scipy(seed: int) -> None:
    """Brent's method, for smooth functions, steep and flat ones, and tolerances from coarse to rounding."""
    rng = np.random.default_rng(seed)
    at, slope, bend = rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(-6.0, 6.0), rng.uniform(-0.2, 0.2)
    functions = (
        lambda x: slope * (x - at) * (1.0 + bend * x),
        lambda x: math.expm1(3.0 * (x - at)) + bend * (x - at) ** 3,
        lambda x: (x - at) ** 3 + 0.01 * (x - at),
        lambda x: math.copysign(slope, x - at),
        lambda x: math.atan(slope * (x - at)),
    )
    low, high = at - rng.uniform(0.1, 2.0), at + rng.uniform(0.1, 2.0)
    absolute = 10.0 ** rng.uniform(-17.0, -3.0)
    for function in functions:
        expected = brentq(function, low, high, xtol=absolute, rtol=1e-15)
        assert root_between(function, low, high, absolute=absolute, relative=1e-15) == expected


def test_ends() -> None:
    """An end at which the function is zero is the root; without a change of sign there need not be one; and interpolation crawls
    towards a root of high multiplicity, as scipy's does."""
    assert root_between(lambda x: x * x, 0.0, 1.0) == 0.0
    assert root_between(lambda x: x - 1.0, 0.0, 1.0) == 1.0
    with pytest.raises(ValueError, match="same sign at 1 and at 2: 1 and 4"):
        root_between(lambda x: x * x, 1.0, 2.0)
    with pytest.raises(RuntimeError, match="after 100 steps"):
        root_between(lambda x: (x - 0.3) ** 9, -1.0, 1.0, absolute=1e-17)

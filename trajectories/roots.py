"""Root of a function of one variable, without scipy, which takes longer to load than a run of a scene takes.

Source: R. P. Brent, *Algorithms for Minimization without Derivatives*, Prentice-Hall 1973, chapter 4. Step by step the same numbers
as scipy's `brentq`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, inf
from sys import float_info

MOST_STEPS = 100
"""Limit of the number of steps; bisection alone needs 53 to a factor of two."""


ROUNDING = 4.0 * float_info.epsilon
"""Smallest relative tolerance that the iteration is sure to reach."""


def root_between(
    function: Callable[[float], float], low: float, high: float, *, absolute: float = 2e-12, relative: float = ROUNDING
) -> float:
    """Return a root of a continuous function between two points of different sign, by Brent's method.

    Args:
        function: the function.
        low, high: ends of the interval; the function's signs differ there, or one is a root.
        absolute, relative: tolerances of the root.

    Raises:
        ValueError: the function has the same sign at both ends.
        RuntimeError: the iteration doesn't converge, as at a root of high multiplicity.
    """
    before, now = float(low), float(high)
    f_before, f_now = function(before), function(now)
    if f_before == 0.0 or f_now == 0.0:
        return before if f_before == 0.0 else now
    if f_before * copysign(1.0, f_now) > 0.0:
        raise ValueError(f"the function has the same sign at {low:g} and at {high:g}: {f_before:g} and {f_now:g}")
    other, f_other, last, step = before, f_before, 0.0, 0.0
    for _ in range(MOST_STEPS):
        # the root is between `now`, the better of both, and `other`
        if f_before != 0.0 and copysign(1.0, f_before) != copysign(1.0, f_now):
            other, f_other = before, f_before
            last = step = now - before
        if abs(f_other) < abs(f_now):
            before, now, other = now, other, now
            f_before, f_now, f_other = f_now, f_other, f_now
        tolerance, half = 0.5 * (absolute + relative * abs(now)), 0.5 * (other - now)
        if f_now == 0.0 or abs(half) < tolerance:
            return now
        # interpolation where that converges faster than halving the interval
        may_interpolate = abs(last) > tolerance and abs(f_now) < abs(f_before)
        trial = _interpolated((before, now, other), (f_before, f_now, f_other)) if may_interpolate else inf
        is_short = 2.0 * abs(trial) < min(abs(last), 3.0 * abs(half) - tolerance)
        last, step = (step, trial) if is_short else (half, half)
        before, f_before = now, f_now
        now += step if abs(step) > tolerance else copysign(tolerance, half)
        f_now = function(now)
    raise RuntimeError(f"no root to within {tolerance:g} after {MOST_STEPS} steps, the last at {now:g}")


def _interpolated(points: tuple[float, float, float], values: tuple[float, float, float]) -> float:
    """Return the step from the second point by the secant through two points, or by inverse quadratic interpolation."""
    (before, now, other), (f_before, f_now, f_other) = points, values
    if before == other:
        return -f_now * (now - before) / (f_now - f_before)
    to_before, to_other = (f_before - f_now) / (before - now), (f_other - f_now) / (other - now)
    return -f_now * (f_other * to_other - f_before * to_before) / (to_other * to_before * (f_other - f_before))

"""Convex quadratic programmes with dense matrices: minimise x'Hx / 2 + c'x subject to A x <= b and lower <= x <= upper.

A primal-dual interior-point method with Mehrotra's predictor and corrector. The matrices of the normal equations have the size of
x, however many limits there are.

Source: J. Nocedal and S. Wright, *Numerical Optimization*, Springer 2006, section 16.6.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from flexfmu.trajectories.jets import RealArray

ITERATIONS = 60
"""Largest number of iterations; 15 to 30 are usual."""

TOLERANCE = 1e-8
"""Complementarity per limit and violation of limits at which the solution is found."""

DUAL = 1e-3
"""Residual of the gradient, in units of the cost, at which it is found; rounding keeps it above 1e-4 where limits are many."""


def solve_quadratic(
    hessian: RealArray, cost: RealArray, matrix: RealArray, right: RealArray, lower: RealArray, upper: RealArray
) -> tuple[RealArray, RealArray]:
    """Solve a convex quadratic programme that has a solution.

    Args:
        hessian: H (n, n), positive semidefinite.
        cost: c (n,).
        matrix, right: A (N, n) and b (N,).
        lower, upper: bounds (n,), infinite where there is none; lower < upper.

    Returns:
        x (n,) and the multipliers of A x <= b (N,), zero or positive.
    """
    n, rows, unit = len(cost), len(right), np.eye(len(cost))
    low, high = np.isfinite(lower), np.isfinite(upper)
    # bounds are limits too
    matrix = np.concatenate([matrix, -unit[low], unit[high]])
    limits = np.concatenate([right, -lower[low], upper[high]])
    x = np.clip(np.zeros(n), lower, upper)
    slack = np.maximum(limits - matrix @ x, 1.0)
    dual = np.ones_like(slack)
    for _ in range(ITERATIONS):
        r_dual = hessian @ x + cost + dual @ matrix
        r_limit = matrix @ x + slack - limits
        gap = float(slack @ dual) / len(slack)
        if gap < TOLERANCE and np.abs(r_limit).max() < TOLERANCE and np.abs(r_dual).max() < DUAL:
            break
        weight = dual / slack
        scaled = np.sqrt(weight[:, np.newaxis]) * matrix
        normal = hessian + scaled.T @ scaled
        normal[np.diag_indices(n)] += 1e-12 * (1 + np.diag(normal))
        factor = cho_factor(normal, check_finite=False)
        right = -r_dual - (weight * r_limit) @ matrix
        # predictor, and corrector towards the centre
        complement = slack * dual
        for corrector in (False, True):
            dx = cho_solve(factor, right + (complement / slack) @ matrix, check_finite=False)
            d_slack = -r_limit - matrix @ dx
            d_dual = -(complement + dual * d_slack) / slack
            if not corrector:
                step = _longest(slack, d_slack), _longest(dual, d_dual)
                after = float((slack + step[0] * d_slack) @ (dual + step[1] * d_dual)) / len(slack)
                complement = slack * dual + d_slack * d_dual - (after / gap) ** 3 * gap
        size = 0.995 * min(_longest(slack, d_slack), _longest(dual, d_dual))
        x, slack, dual = x + size * dx, slack + size * d_slack, dual + size * d_dual
    return x, dual[:rows]


def _longest(values: RealArray, change: RealArray) -> float:
    """Longest step, up to 1, that keeps values positive."""
    falling = change < 0.0
    return min(1.0, float((-values[falling] / change[falling]).min(initial=1.0)))

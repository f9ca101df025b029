"""Descents of a tuning from its best trials, by gradients or without them.

Loops have rounding, limits and events, and their figures are peaks: their derivatives are differences of runs. The largest of
several figures has a kink, each of them is smooth: programs bound all of them.
"""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.design.gains.search import Search
from flexfmu.cosim.engine.slave import RealArray

RADIUS, LEAST_RADIUS = 0.15, 2e-3
"""First and last radius of the trust region, as shares of the intervals."""

DIFFERENCE = 4e-3
"""Step of differences, as a share of the interval: large beside a run's error, small beside the curvature of figures."""

LARGEST_RADIUS, SHRINKING = 0.5, 0.4
"""Largest radius in a descent by gradients; radius after a step that gained little, as a share of the step."""

LEAST_GAIN = 1e-4
"""Foreseen gain at which a descent by gradients ends: 0.01 % of the figure."""

PENALTY = 10.0
"""Weight of what exceeds a condition in a descent by gradients: 0.1 % of the limit like 10 % of the figure."""

GOOD, POOR = 0.75, 0.25
"""Share of the foreseen gain from which the trust region grows, and below which it shrinks."""

INSIDE = 1e-3
"""How far within a condition linear steps aim: 0.01 % of the limit."""


def descend_by_models(search: Search) -> None:
    """Improve the best trials so far, one after the other, by COBYQA, a trust-region method with quadratic models.

    Source: T. Ragonneau, Model-based derivative-free optimization methods and software, PhD thesis, Hong Kong 2022.

    Raises:
        Spent: all trials are made before nothing more is gained.
    """
    from scipy.optimize import Bounds, NonlinearConstraint, minimize

    parts, count = len(search.study.minimise.parts), len(search.study.over)

    def figure(shares: RealArray) -> float:
        return float(search.costs_at(shares)[:parts].max())

    def excesses(shares: RealArray) -> RealArray:
        return search.costs_at(shares)[parts:]

    kept = NonlinearConstraint(excesses, -np.inf, 0.0)
    options: dict[str, Any] = {
        "method": "COBYQA",
        "bounds": Bounds(np.zeros(count), np.ones(count)),
        "constraints": [kept] if search.study.conditions else [],
        "options": {"initial_tr_radius": RADIUS, "final_tr_radius": LEAST_RADIUS},
    }
    for start in search.starts():
        minimize(figure, start, **options)


def descend_by_gradients(search: Search) -> None:
    """Improve the best trials so far, one after the other, by sequential quadratic programs within a trust region.

    Each step has differences of runs, which all processors make at once, and a program: the change of the shares that makes the
    largest part of the figure smallest and keeps all conditions. Both are linear about the last point; the curvature is that of the
    Lagrangian, by damped BFGS. Source: J. Nocedal and S. Wright, Numerical Optimization, 2006, chapter 18.

    Raises:
        Spent: all trials are made before nothing more is gained.
    """
    for start in search.starts():
        _descend(search, start)


def _descend(search: Search, point: RealArray) -> None:
    """Go down from shares (n,) of the intervals."""
    parts = len(search.study.minimise.parts)
    costs, slopes = search.costs_at(point), _differences(search, point)
    curvature, radius = np.zeros((len(point), len(point))), RADIUS
    while radius > LEAST_RADIUS:
        step, expected, multipliers = _programmed(costs, slopes, curvature, parts, point, radius)
        if expected < LEAST_GAIN:
            return
        new = search.costs_at(point + step)
        if _merit(costs, parts) - _merit(new, parts) < GOOD * expected:
            # second-order correction: the same program about what the step has shown
            other, _, _ = _programmed(new - slopes @ step, slopes, curvature, parts, point, radius)
            if _merit(corrected := search.costs_at(point + other), parts) < _merit(new, parts):
                step, new = other, corrected
        # the region grows where the program foresaw the gain, and shrinks where it didn't
        gain = _merit(costs, parts) - _merit(new, parts)
        if gain > GOOD * expected:
            radius = min(2.0 * radius, LARGEST_RADIUS)
        elif gain < POOR * expected:
            radius = SHRINKING * min(radius, float(np.abs(step).max()))
        if gain > 0.0:
            before, slopes = slopes, _differences(search, point + step)
            curvature = _updated(curvature, step, multipliers @ (slopes - before))
            point, costs = point + step, new


def _merit(costs: RealArray, parts: int) -> float:
    """The largest part, and a penalty for what exceeds conditions."""
    return float(costs[:parts].max() + PENALTY * np.maximum(costs[parts:], 0.0).sum())


def _updated(curvature: RealArray, step: RealArray, change: RealArray) -> RealArray:
    """The curvature (n, n) after a step (n,) along which the gradient has changed, by damped BFGS: it stays positive."""
    if not curvature.any():
        # the first one is a sphere
        curvature = max(float(change @ step) / float(step @ step), 1e-6) * np.eye(len(step))
    known = curvature @ step
    along = float(step @ known)
    if (found := float(step @ change)) < 0.2 * along:
        share = 0.8 * along / (along - found)
        change = share * change + (1.0 - share) * known
    return np.asarray(curvature - np.outer(known, known) / along + np.outer(change, change) / float(step @ change))


def _programmed(
    costs: RealArray, slopes: RealArray, curvature: RealArray, parts: int, point: RealArray, radius: float
) -> tuple[RealArray, float, RealArray]:
    """The change (n,) of the shares within the radius that lowers costs most, by how much, and the multipliers of the costs."""
    n, conditions = len(point), len(costs) - parts
    # unknowns: the change, the largest part, the excess of each condition
    hessian = np.zeros((n + 1 + conditions,) * 2)
    hessian[:n, :n] = curvature
    rows = np.zeros((len(costs), n + 1 + conditions))
    rows[:, :n], rows[:parts, n], rows[parts:, n + 1 :] = slopes, -1.0, -np.eye(conditions)
    program = casadi.conic(
        "program",
        "highs",
        {"h": casadi.DM(hessian).sparsity(), "a": casadi.Sparsity.dense(*rows.shape)},
        {"highs": {"output_flag": False}, "error_on_fail": False},
    )
    found = program(
        h=hessian,
        g=np.concatenate([np.zeros(n), [1.0], np.full(conditions, PENALTY)]),
        a=rows,
        lba=-np.inf,
        uba=-np.concatenate([costs[:parts], costs[parts:] + INSIDE]),
        lbx=np.concatenate([np.maximum(-radius, -point), [-np.inf], np.zeros(conditions)]),
        ubx=np.concatenate([np.minimum(radius, 1.0 - point), np.full(1 + conditions, np.inf)]),
    )
    # a program that fails foresees no gain
    before = _merit(np.append(costs[:parts], costs[parts:] + INSIDE), parts)
    expected = before - float(found["cost"]) if program.stats()["success"] else 0.0
    return found["x"].full()[:n, 0], expected, found["lam_a"].full()[:, 0]


def _differences(search: Search, shares: RealArray) -> RealArray:
    """Derivatives (costs, n) by shares: differences to the inside of the intervals, to the other side where that run fails."""
    steps = np.where(shares + DIFFERENCE <= 1.0, DIFFERENCE, -DIFFERENCE)
    here = search.at(shares)
    base, *trials = search.try_all([here, *(search.at(shares + step) for step in np.diag(steps))])
    columns = []
    for i, trial in enumerate(trials):
        if trial.message and 0.0 <= shares[i] - steps[i] <= 1.0:
            steps[i] = -steps[i]
            trial = search.try_all([search.at(shares + steps[i] * np.eye(len(shares))[i])])[0]
        # values are rounded, so that the step is what was tried
        interval = search.study.over[i]
        moved = interval.share_of(trial.values[i]) - interval.share_of(here[i])
        columns.append((search.cost(trial) - search.cost(base)) / (moved or 1.0))
    return np.column_stack(columns)

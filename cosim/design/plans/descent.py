"""Improves the numbers of a recipe by linear programmes.

All figures of a motion at all instants are linearised by differences in each number. A linear programme then finds the change within
a trust region that lowers what is minimised, with exceeded limits added, most; the region grows where the motion gains what was
predicted, and shrinks where it doesn't.

Source: J. Nocedal, S. J. Wright, *Numerical Optimization*, 2nd edition, Springer 2006, section 18.8 (sequential l1 linear-quadratic
programming), here without the quadratic part: as many limits are active as there are numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flexfmu.cosim.design.plans.scoring import CLEARANCE, INSIDE, WORTH, Score
from flexfmu.trajectories.jets import RealArray

NEAR, REACH = 0.35, 10.0
"""Rows within this of the largest, or of the limit, are linearised: others don't become active within a step. Those of the clearance
are `LENGTH` apart, see `flexfmu.cosim.design.plans.scoring`."""

MOST_ROWS = 2000
"""Largest number of rows of a limit."""


def best_change(
    score: Score,
    neighbours: list[Score | None],
    differences: RealArray,
    tighter: Mapping[str, float],
    low: RealArray,
    high: RealArray,
    further: tuple[RealArray, RealArray],
) -> tuple[RealArray, float]:
    """Return the change of the numbers (n,) with the smallest predicted cost, and the predicted decrease of the cost.

    Args:
        score: of the motion.
        neighbours: n scores, each with one number changed; None for one that can't be run.
        differences: (n,) changes of the numbers of these.
        tighter: as for `Score.cost`.
        low, high: (n,) bounds of the changes.
        further: linear functions that have to stay above zero: values (M,) and slopes (M, n).
    """
    from scipy.optimize import linprog

    known = np.array([each is not None for each in neighbours])
    low, high = np.where(known, low, 0.0), np.where(known, high, 0.0)
    others = [score if each is None else each for each in neighbours]
    # what is minimised in its own unit, then the limits, each below 1 plus its excess
    unit = float(score.minimised.max()) or 1.0
    parts = [_part(score.minimised / unit, [each.minimised / unit for each in others], NEAR, 0.0)]
    now, weights = 1.0, [1.0]
    for name, factor in ((name, tighter.get(name, INSIDE)) for name in score.rows):
        if factor > 0.0:
            worst = factor * float(score.rows[name].max())
            unit, reach = (1.0, REACH) if name == CLEARANCE else (max(1.0, worst), NEAR)
            rows, *shifted = (factor / unit * each.rows[name] for each in (score, *others))
            parts.append(_part(rows, shifted, reach, 1.0 / unit))
            now += WORTH * max(0.0, worst - 1.0) / unit
            weights.append(WORTH)
    # one slack for each of them
    slacks = np.repeat(-np.eye(len(parts)), [len(right) for _, right in parts], axis=0)
    slopes = np.concatenate([*(slopes / differences for slopes, _ in parts), -further[1]])
    found = linprog(
        np.array([*np.zeros(len(low)), *weights]),
        A_ub=np.hstack([slopes, np.concatenate([slacks, np.zeros((len(further[0]), len(parts)))])]),
        b_ub=np.concatenate([*(right for _, right in parts), further[0]]),
        bounds=[*zip(low, high, strict=True), *[(0.0, None)] * len(parts)],
        method="highs",
    )
    if found.x is None:
        return np.zeros(len(low)), 0.0
    return np.asarray(found.x[: len(low)]), now - float(found.fun or 0.0)


def _part(rows: RealArray, further: Sequence[RealArray], reach: float, limit: float) -> tuple[RealArray, RealArray]:
    """Differences (M, n) of the rows that may become active, and by how much each is below the limit (M,)."""
    index = np.flatnonzero(rows > min(float(rows.max()), limit) - reach)
    if index.size > MOST_ROWS:
        index = index[np.argsort(-rows[index], kind="stable")[:MOST_ROWS]]
    return np.stack([each[index] - rows[index] for each in further], axis=1), limit - rows[index]

"""Recognises a coupling that blows up: signals round closed loops that grow faster than the steps can resolve.

A physical instability that the communication steps resolve changes a signal by little from step to step. Where, over
many steps, a signal changes each time by about as much as it amounts to, and ever more, what grows is made by the
coupling (or can't be told from it with this step).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WINDOW = 8
"""Steps in a window: spans the period of anything that alternates faster than a step resolves."""

WINDOWS = 4
"""Consecutive windows at the end of a run that must all show the growth."""

GROWTH = 2.0
"""Least growth of the largest change from window to window."""

UNRESOLVED = 0.5
"""Least change from step to step, relative to the largest magnitude in its window."""

TOTAL_GROWTH = 1e6
"""Least growth of the magnitude over the run, from its first tenth: far from anything that a stable loop does while it settles."""


@dataclass(frozen=True)
class Instability:
    """A signal that blew up.

    Attributes:
        signal: its name.
        growth: factor by which its change grew from step to step, at the end.
        since: when it began to grow [s].
    """

    signal: str
    growth: float
    since: float


def find_instability(
    time: NDArray[np.float64], signals: Iterable[tuple[str, NDArray[np.float64]]]
) -> Instability | None:
    """The signal whose step-to-step change grew most, if any blew up.

    Args:
        time: (N,) communication points [s]; of those that appear twice the last counts.
        signals: name and values (N,) of what goes round closed loops.
    """
    count = WINDOW * WINDOWS
    last = np.append(np.diff(time) > 0.0, True) if time.size else np.zeros(0, dtype=np.bool_)
    if last.sum() <= count:
        return None
    found = [_judge(time[last], name, values[last]) for name, values in signals]
    return max((each for each in found if each is not None), key=lambda each: each.growth, default=None)


def _judge(time: NDArray[np.float64], name: str, values: NDArray[np.float64]) -> Instability | None:
    """Whether this signal blew up."""
    count = WINDOW * WINDOWS
    change = abs(np.diff(values))[-count:].reshape(WINDOWS, WINDOW).max(axis=1)
    magnitude = abs(values[-count:]).reshape(WINDOWS, WINDOW).max(axis=1)
    before = float(abs(values[: max(2, values.size // 10)]).max())
    grows = bool((change[1:] >= GROWTH * change[:-1]).all()) and change[0] > 0.0
    unresolved = bool((change >= UNRESOLVED * magnitude).all())
    if not (grows and unresolved and magnitude[-1] >= TOTAL_GROWTH * before):
        return None
    growth = float((change[-1] / change[0]) ** (1.0 / (count - WINDOW)))
    since = int(np.argmax(abs(values) > 10.0 * before))
    return Instability(name, growth, float(time[since]))

"""Recognises a coupling that blows up: signals round closed loops that grow faster than the steps can resolve.

A physical instability that the communication steps resolve changes a signal by little from step to step. Where, over
many steps, a signal changes each time by about as much as it amounts to, and ever more, what grows is made by the
coupling (or can't be distinguished from that with this step). And where a signal goes up and down from each step to the next, ever
further, a loop overshoots more every time it is closed: its gain is too high for the step, or for the sample time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.slave import RealArray

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


ALTERNATIONS = 5
"""Consecutive changes of opposite sign, none smaller than the one before, that show a loop which overshoots."""

ALTERNATING_GROWTH = 100.0
"""Least growth of these changes from the first to the last; its square root in their second half, since growth that multiplies
goes on while that of a resonance adds up."""

BEYOND_PAST = 10.0
"""Least last one of these changes relative to the signal's largest magnitude before: vibrations beat, and may die down and
come up again."""

FINAL_SHARE = 0.1
"""Least last one of these changes relative to the signal's largest magnitude in the run: rounding errors alternate, too."""


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


def find_instability(time: RealArray, signals: Iterable[tuple[str, RealArray]]) -> Instability | None:
    """The signal whose step-to-step change grew most, if any blew up.

    Args:
        time: (N,) communication points [s]; of those that appear twice the last counts.
        signals: name and values (N,) of what goes round closed loops.
    """
    last = _right_limits(time)
    if last.sum() <= WINDOW * WINDOWS:
        return None
    return _fastest(_judge(time[last], name, values[last]) for name, values in signals)


def find_alternation(time: RealArray, signals: Iterable[tuple[str, RealArray]]) -> Instability | None:
    """The signal that overshot most, if any went up and down from step to step, ever further.

    Args:
        time: (N,) communication points [s]; of those that appear twice the last counts.
        signals: name and values (N,) of what goes round closed loops, sampled ones included.
    """
    last = _right_limits(time)
    return _fastest(_overshooting(time[last], name, values[last]) for name, values in signals)


def _right_limits(time: RealArray) -> NDArray[np.bool_]:
    """Which points count."""
    return np.append(np.diff(time) > 0.0, True) if time.size else np.zeros(0, dtype=np.bool_)


def _fastest(found: Iterable[Instability | None]) -> Instability | None:
    return max((each for each in found if each is not None), key=lambda each: each.growth, default=None)


def _overshooting(time: RealArray, name: str, values: RealArray) -> Instability | None:
    """Whether this signal overshot: the stretch of growing alternation that grows fastest."""
    # stretches of changes of opposite sign, none smaller than the one before
    change = np.diff(values)
    size = abs(change)
    follows = (change[1:] * change[:-1] < 0.0) & (size[1:] >= size[:-1])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], follows, [False]]).astype(np.int8)))
    return _fastest(
        Instability(name, float(size[end] / size[begin]) ** (1.0 / (end - begin)), float(time[begin + 1]))
        for begin, end in edges.reshape(-1, 2).tolist()
        if end - begin >= ALTERNATIONS - 1 and _explodes(size[begin : end + 1], values, begin)
    )


def _explodes(size: RealArray, values: RealArray, begin: int) -> bool:
    """Whether changes of these sizes, that alternate from point ``begin`` on, show more than a vibration that comes up."""
    total, late = size[-1] / size[0], size[-1] / size[size.size // 2]
    exceeds_past = size[-1] >= BEYOND_PAST * abs(values[: begin + 1]).max()
    lasting = size[-1] >= FINAL_SHARE * abs(values).max()
    return bool(total >= ALTERNATING_GROWTH and late >= ALTERNATING_GROWTH**0.5 and exceeds_past and lasting)


def _judge(time: RealArray, name: str, values: RealArray) -> Instability | None:
    """Whether this signal blew up."""
    # largest change and magnitude in each of the last windows
    count = WINDOW * WINDOWS
    change = abs(np.diff(values))[-count:].reshape(WINDOWS, WINDOW).max(axis=1)
    magnitude = abs(values[-count:]).reshape(WINDOWS, WINDOW).max(axis=1)
    # it grows from window to window, faster than the steps resolve, far beyond what it was in the beginning
    before = float(abs(values[: max(2, values.size // 10)]).max())
    grows = bool((change[1:] >= GROWTH * change[:-1]).all()) and change[0] > 0.0
    unresolved = bool((change >= UNRESOLVED * magnitude).all())
    if not (grows and unresolved and magnitude[-1] >= TOTAL_GROWTH * before):
        return None
    growth = float((change[-1] / change[0]) ** (1.0 / (count - WINDOW)))
    since = int(np.argmax(abs(values) > 10.0 * before))
    return Instability(name, growth, float(time[since]))

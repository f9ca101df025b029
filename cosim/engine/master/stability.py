"""Detects an unstable coupling: signals in closed loops that grow faster than the communication steps can resolve.

A physical instability that the steps resolve changes a signal by little from step to step. If the changes from step to
step keep growing over many steps and are about as large as the signal itself, the coupling is unstable (or can't be
distinguished from an unstable one with this step). If a signal alternates from step to step with growing amplitude, the
gain of its loop is too high for the communication step or the sample time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.slave import RealArray

WINDOW = 8
"""Number of steps in a window: longer than the period of any oscillation that the steps don't resolve."""

WINDOWS = 4
"""Number of consecutive windows at the end of a run that must all show the growth."""

GROWTH = 2.0
"""Least growth factor of the largest change from window to window."""

UNRESOLVED = 0.5
"""Least value of a window's largest change from step to step, relative to its largest magnitude."""

TOTAL_GROWTH = 1e6
"""Least growth factor of the magnitude since the first tenth of the run: far beyond the overshoot of a stable loop."""


ALTERNATIONS = 5
"""Least number of consecutive changes of alternating sign, none smaller than the one before."""

ALTERNATING_GROWTH = 100.0
"""Least growth factor of these changes from first to last; its square root is the least factor in their second half,
since an instability grows exponentially, a resonance only linearly."""

BEYOND_PAST = 10.0
"""Least size of the last of these changes, relative to the signal's largest magnitude before them: beats of a vibration
fade and grow again, but not beyond it."""

FINAL_SHARE = 0.1
"""Least size of the last of these changes, relative to the signal's largest magnitude in the run: rounding errors
alternate, too."""


@dataclass(frozen=True)
class Instability:
    """A signal that shows an unstable coupling.

    Attributes:
        signal: its name, ``slave.output``.
        growth: mean factor by which its change grew from step to step.
        since: time at which it began to grow [s].
    """

    signal: str
    growth: float
    since: float


def find_instability(time: RealArray, signals: Iterable[tuple[str, RealArray]]) -> Instability | None:
    """The signal whose change from step to step grew fastest; None if none is unstable.

    Args:
        time: (N,) recorded instants [s]; of two equal ones the last counts.
        signals: (name, values (N,)) of signals in closed loops.
    """
    known = list(signals)
    if not known:
        return None
    last = _right_limits(time)
    if last.sum() <= WINDOW * WINDOWS:
        return None
    instants = time[last]
    return _fastest(_judge(instants, name, values[last]) for name, values in known)


def find_alternation(time: RealArray, signals: Iterable[tuple[str, RealArray]]) -> Instability | None:
    """The signal whose alternating change from step to step grew fastest; None if none is unstable.

    Args:
        time: (N,) recorded instants [s]; of two equal ones the last counts.
        signals: (name, values (N,)) of signals in closed loops, those of sampled slaves included.
    """
    known = list(signals)
    if not known:
        return None
    last = _right_limits(time)
    instants = time[last]
    return _fastest(_overshooting(instants, name, values[last]) for name, values in known)


def _right_limits(time: RealArray) -> NDArray[np.bool_]:
    """(N,) whether the instant is the last of equal ones."""
    return np.append(np.diff(time) > 0.0, True) if time.size else np.zeros(0, dtype=np.bool_)


def _fastest(found: Iterable[Instability | None]) -> Instability | None:
    return max((each for each in found if each is not None), key=lambda each: each.growth, default=None)


def _overshooting(time: RealArray, name: str, values: RealArray) -> Instability | None:
    """The fastest growing alternation of this signal; None if there is none."""
    # intervals with changes of alternating sign, none smaller than the one before
    change = np.diff(values)
    size = abs(change)
    follows = (change[1:] * change[:-1] < 0.0) & (size[1:] >= size[:-1])
    bounded = np.concatenate([[False], follows, [False]])
    edges = np.flatnonzero(bounded[1:] != bounded[:-1]).reshape(-1, 2)
    long = edges[edges[:, 1] - edges[:, 0] >= ALTERNATIONS - 1]
    return _fastest(
        Instability(name, float(size[end] / size[begin]) ** (1.0 / (end - begin)), float(time[begin + 1]))
        for begin, end in long.tolist()
        if _explodes(size[begin : end + 1], values, begin)
    )


def _explodes(size: RealArray, values: RealArray, begin: int) -> bool:
    """Whether changes of these sizes, alternating from point ``begin`` on, show an instability, not a vibration."""
    total, late = size[-1] / size[0], size[-1] / size[size.size // 2]
    exceeds_past = size[-1] >= BEYOND_PAST * abs(values[: begin + 1]).max()
    lasting = size[-1] >= FINAL_SHARE * abs(values).max()
    return bool(total >= ALTERNATING_GROWTH and late >= ALTERNATING_GROWTH**0.5 and exceeds_past and lasting)


def _judge(time: RealArray, name: str, values: RealArray) -> Instability | None:
    """The growth of this signal at the end of the run; None if it is not unstable."""
    # largest change and magnitude in each of the last windows
    count = WINDOW * WINDOWS
    change = abs(np.diff(values))[-count:].reshape(WINDOWS, WINDOW).max(axis=1)
    magnitude = abs(values[-count:]).reshape(WINDOWS, WINDOW).max(axis=1)
    # it grows from window to window, faster than the steps resolve, and far beyond its initial magnitude
    before = float(abs(values[: max(2, values.size // 10)]).max())
    grows = bool((change[1:] >= GROWTH * change[:-1]).all()) and change[0] > 0.0
    unresolved = bool((change >= UNRESOLVED * magnitude).all())
    if not (grows and unresolved and magnitude[-1] >= TOTAL_GROWTH * before):
        return None
    growth = float((change[-1] / change[0]) ** (1.0 / (count - WINDOW)))
    since = int(np.argmax(abs(values) > 10.0 * before))
    return Instability(name, growth, float(time[since]))

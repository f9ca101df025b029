"""What a study says, in a sentence."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from flexfmu.cosim.workprec.study import OURS, Study
from flexfmu.cosim.workprec.tool_trials import PAPER_LINE
from flexfmu.cosim.workprec.trial import Curve, Trial

ASKED = 1e-5, 1e-3
"""Accuracies that the sentence speaks of."""

COMPARED = 1e-5
"""Error at which other tools are compared, where they reach it."""

CHOICES = ("integrators", "communication")
"""Families between whose settings a user of this FMU chooses."""


def cheapest(trials: Iterable[Trial], error: float) -> Trial | None:
    """The fastest trial that is at least so accurate."""
    good = [each for each in trials if each.error is not None and each.error <= error and each.time is not None]
    return min(good, key=lambda each: each.time or 0.0, default=None)


def sentence(study: Study) -> str:
    """What accuracy costs on this scene."""
    ours = [each for each in study.trials if each.family in CHOICES]
    first, second = (cheapest(ours, error) for error in ASKED)
    if first is None or first.time is None:
        return f"No setting reached {ASKED[0]:.0e}."
    text = (
        f"{ASKED[0]:.0e} costs {1e3 * first.time:.1f} ms ({study.duration / first.time:.0f} x real time) with {first.line}, "
        f"{first.label}"
    )
    if second is None or second.time is None:
        return f"{text}."
    same = second is first
    cost = "the same" if same else f"{second.line}, {second.label}: {1e3 * second.time:.1f} ms"
    return f"{text}; the cheapest setting for {ASKED[1]:.0e} is {cost}."


@dataclass(frozen=True)
class Advantage:
    """How much longer another tool takes than ours.

    Attributes:
        error: that both have.
        ratio: its time over ours, each interpolated on the curve of the best settings.
    """

    error: float
    ratio: float


def advantages(study: Study) -> dict[str, Advantage]:
    """Line of another tool → what it takes for an error of `COMPARED`, or for the nearest one that it has reached."""
    tools = study.family("tools")
    curves = {
        line: Curve.of(each for each in tools if each.line == line)
        for line in dict.fromkeys(each.line for each in tools)
    }
    ours, found = curves.pop(OURS, Curve(())), {}
    curves.pop(PAPER_LINE, None)  # our own solver, and the beginning of the motion alone
    for line, curve in curves.items():
        error = min(max(COMPARED, curve.least, ours.least), curve.most)
        own, theirs = ours.time(error), curve.time(error)
        if own and theirs:
            found[line] = Advantage(error, theirs / own)
    return found

"""What a study says, in a sentence."""

from __future__ import annotations

from collections.abc import Iterable

from flexfmu.cosim.workprec.study import Study
from flexfmu.cosim.workprec.trial import Trial

ASKED = 1e-5, 1e-3
"""Accuracies that the sentence speaks of."""

OURS = ("integrators", "communication")
"""Families between whose settings a user of this FMU chooses."""


def cheapest(trials: Iterable[Trial], error: float) -> Trial | None:
    """The fastest trial that is at least so accurate."""
    good = [each for each in trials if each.error is not None and each.error <= error and each.time is not None]
    return min(good, key=lambda each: each.time or 0.0, default=None)


def sentence(study: Study) -> str:
    """What accuracy costs on this scene."""
    ours = [each for each in study.trials if each.family in OURS]
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


def advantages(study: Study) -> dict[str, float]:
    """Line of another tool → how many times longer it takes than our fastest setting of at least the same accuracy; of all
    its settings the one that does best."""
    found = {}
    for line in dict.fromkeys(each.line for each in study.family("tools")):
        theirs = [each for each in study.family("tools") if each.line == line and each.error is not None]
        ratios = [_ratio(study, each) for each in theirs]
        known = [ratio for ratio in ratios if ratio is not None]
        if known:
            found[line] = min(known)
    return found


def _ratio(study: Study, theirs: Trial) -> float | None:
    ours = cheapest([each for each in study.trials if each.family in OURS], theirs.error or 0.0)
    return None if ours is None or not ours.time or theirs.time is None else theirs.time / ours.time

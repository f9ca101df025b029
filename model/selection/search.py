"""The cheapest set of effects within a tolerance: start with all, and leave out what is worth least."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from flexfmu.model.enrichment import Neighbour, enrichments, reductions
from flexfmu.model.scene import CHOOSABLE, Scene

Error = Callable[[Scene], float]
"""Scene → error of its set of effects, the largest over all metrics."""

HOPELESS = 3.0
"""Error of a quick estimate, in units of the limit, from which a set isn't looked at more sharply."""


def cheapest(richest: Scene, rigid: Scene, quick: Error, sharp: Error, limit: float) -> Scene:
    """A scene whose error is within the limit and from which nothing more can be left out.

    Rigid links are tried first. Otherwise in each round, of the reductions that are within the limit, the one with the smallest quick estimate is taken.

    Args:
        richest, rigid: with all effects and with none.
        quick, sharp: estimates of the error of a scene's set; the second one decides.
        limit: largest error.
    """
    if quick(rigid) <= HOPELESS * limit and sharp(rigid) <= limit:
        return rigid
    scene: Scene | None = richest
    while scene is not None:
        found = scene
        ranked = sorted(((quick(each.scene), each.scene) for each in poorer(scene)), key=lambda pair: pair[0])
        promising = (each for error, each in ranked if error <= HOPELESS * limit)
        scene = next((each for each in promising if sharp(each) <= limit), None)
    return found


def poorer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode less."""
    return (neighbour for neighbour in reductions(scene) if neighbour.effect in CHOOSABLE)


def richer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode more."""
    return (neighbour for neighbour in enrichments(scene) if neighbour.effect in CHOOSABLE)

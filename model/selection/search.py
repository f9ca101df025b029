"""The cheapest set of effects within a tolerance: start with all, and leave out what is worth least, alone or in pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from flexfmu.model.enrichment import Neighbour, enrichments, reductions
from flexfmu.model.scene import CHOOSABLE, Scene

Error = Callable[[Scene], float]
"""Scene → error of its set of effects, the largest over all metrics."""

HOPELESS = 3.0
"""Error of a quick estimate, in units of the limit, from which a set isn't looked at more sharply."""


def cheapest(richest: Scene, rigid: Scene, quick: Error, sharp: Error, limit: float) -> Scene:
    """A scene whose error is within the limit and from which nothing more can be left out, neither one effect nor two at once.

    Rigid links are tried first. Otherwise in each round, of the reductions that are within the limit, the one with the smallest
    quick estimate is taken. Errors of opposite sign make up for each other, so that two effects may be left out together where
    neither may go alone: such pairs are looked at where no single one is left.

    Args:
        richest, rigid: with all effects and with none.
        quick, sharp: estimates of the error of a scene's set; the second one decides.
        limit: largest error.
    """
    if quick(rigid) <= HOPELESS * limit and sharp(rigid) <= limit:
        return rigid

    def best(candidates: Iterable[Scene]) -> Scene | None:
        ranked = sorted(((quick(each), each) for each in candidates), key=lambda pair: pair[0])
        promising = (each for error, each in ranked if error <= HOPELESS * limit)
        return next((each for each in promising if sharp(each) <= limit), None)

    scene: Scene | None = richest
    while scene is not None:
        found = scene
        scene = best(each.scene for each in poorer(found)) or best(_two_poorer(found))
    return found


def _two_poorer(scene: Scene) -> Iterable[Scene]:
    """All scenes with two effects or modes less, each once."""
    pairs = [second.scene for first in poorer(scene) for second in poorer(first.scene)]
    return {each.effects.model_dump_json(): each for each in pairs}.values()


def poorer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode less."""
    return (neighbour for neighbour in reductions(scene) if neighbour.effect in CHOOSABLE)


def richer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode more."""
    return (neighbour for neighbour in enrichments(scene) if neighbour.effect in CHOOSABLE)

"""The cheapest set of effects within a tolerance: start with all, and leave out what is worth least."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from flexfmu.model.enrichment import Neighbour, enrichments, reductions
from flexfmu.model.scene import CHOOSABLE, Scene

Error = Callable[[Scene], float]
"""Scene → error of its set of effects, the largest over all metrics."""


def cheapest(richest: Scene, error: Error, limit: float) -> Scene:
    """A scene whose error is within the limit and from which nothing more can be left out.

    In each round the reduction with the smallest error is taken. A family becomes rigid, rather than static, where it may.

    Args:
        richest: with all effects.
        error: of the scene's set.
        limit: largest error.
    """
    scene = richest
    while within := [
        (found, neighbour.scene) for neighbour in poorer(scene) if (found := error(neighbour.scene)) <= limit
    ]:
        scene = min(within, key=lambda pair: pair[0])[1]
    return scene


def poorer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode less."""
    return (neighbour for neighbour in reductions(scene) if neighbour.effect in CHOOSABLE)


def richer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode more."""
    return (neighbour for neighbour in enrichments(scene) if neighbour.effect in CHOOSABLE)

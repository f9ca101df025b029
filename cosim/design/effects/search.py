"""Searches the cheapest set of effects for a scene and estimates the contribution of each effect.

The search is a backward elimination: it starts with all effects and leaves out those that contribute least, alone or in
pairs, while the estimated errors are within the limit. Loads such as gravity are never left out; their contributions
are estimated too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import get_args

from flexfmu.cosim.design.effects.estimator import Estimator, MetricValues, richest, with_set
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.metrics.small_deflections import MOST_FOUND
from flexfmu.model.enrichment import Neighbour, enrichments, reductions
from flexfmu.model.scene.choice import MeasureName
from flexfmu.model.scene.effects import CHOOSABLE, FamilyName
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

SAFETY = 1.5
"""Safety factor on estimated errors: one Newton iteration and finite time steps leave an error of some percent."""

CONVERGED = 0.1
"""Largest difference of the richest set from the next richer one, in units of what is allowed."""

MOST_MODES = 8
"""Largest number of modes of a family in the richest set."""


def rich_enough(
    scene: Scene, motion: Trajectory, units: MetricValues, tolerance: float, journal: WorkJournal = NOWHERE
) -> Scene:
    """Return the scene with a richest set that one more mode of every family changes by at most `CONVERGED`.

    The set starts as `RICHEST`; modes are added by the size of their contribution, up to `MOST_MODES`. Foreshortening hardly depends
    on the number of modes and is left out meanwhile. Bending is geometrically exact if that makes a difference of `CONVERGED`.

    Args:
        scene, motion, journal: as for `Estimator`.
        units: what is allowed of each metric [SI].
        tolerance: relative error of the path below which bending needn't be exact.
    """

    def estimator_of(most: Scene) -> Estimator:
        return Estimator(scene, motion, tuple(units), most, journal).scaled(units)

    most = richest(scene)
    while True:
        # compare with one more mode of every family
        grown_most = one_more(most, get_args(FamilyName))
        plain, grown = (each.replace({"effects.foreshortening": False}) for each in (most, grown_most))
        estimator = estimator_of(grown)
        # add the mode with the largest contribution until the rest is negligible
        while max(estimator.errors(plain.effects).values()) > CONVERGED:
            steps = [one_more(plain, [family]) for family in get_args(FamilyName)]
            plain = min(
                (each for each in steps if estimator.covers(each.effects) and each != plain),
                key=lambda each: max(estimator.errors(each.effects).values()),
            )
        # done when no mode was added, or none can be
        found = plain.replace({"effects.foreshortening": True})
        if found == most or grown_most == most:
            break
        most = found
    # geometrically exact bending, where links bend so far that it can matter
    exact = most.replace({"effects.foreshortening": "exact"})
    if MOST_FOUND[True] * estimator.largest_deflection**2 <= CONVERGED * tolerance:
        return most
    bends = max(estimator_of(exact).errors(most.effects).values()) > CONVERGED
    return exact if bends else most


def one_more(scene: Scene, families: Sequence[str]) -> Scene:
    """Return the scene with one more mode of these families, up to `MOST_MODES`."""
    return scene.replace({f"effects.{key}": min(getattr(scene.effects, key) + 1, MOST_MODES) for key in families})


def smallest_set(
    estimates: Estimator, safety: Mapping[MeasureName, float], limit: float, most: Scene | None = None
) -> Scene:
    """Return the scene with the cheapest part of a set whose estimated errors, each with its safety factor, are within a limit.

    Args:
        estimates: of the errors.
        safety: safety factor of each metric.
        limit: largest error.
        most: the scene with the set; the estimates' richest when None.
    """
    most = most or estimates.richest

    def error(each: Scene, sharp: bool) -> float:
        return max(safety[name] * value for name, value in estimates.errors(each.effects, sharp=sharp).items())

    return cheapest(most, with_set(most, {}), lambda each: error(each, False), lambda each: error(each, True), limit)


def neighbours(estimator: Estimator, chosen: Scene) -> list[tuple[Neighbour, bool]]:
    """Return the scenes with one effect less (True) and with one effect more (False), within the richest set."""
    found = [(each, True) for each in poorer(chosen)] + [(each, False) for each in richer(chosen)]
    return [pair for pair in found if estimator.covers(pair[0].scene.effects)]


Error = Callable[[Scene], float]
"""Scene → error of its set of effects, the largest over all metrics."""

HOPELESS = 3.0
"""Error of a quick estimate, in units of the limit, above which no sharp estimate is made."""


def cheapest(richest: Scene, rigid: Scene, quick: Error, sharp: Error, limit: float) -> Scene:
    """Return a scene with an error within the limit, from which neither one effect nor two at once can be left out.

    Rigid links are tried first. Otherwise each round takes, of the reductions within the limit, the one with the
    smallest quick estimate. Errors of opposite sign compensate, so two effects may be left out together where neither
    may be left out alone: pairs are tried where no single effect can be left out.

    Args:
        richest, rigid: the scene with all effects and with none.
        quick, sharp: estimates of the error of a scene's set; the second one decides.
        limit: largest error.
    """
    # rigid links are cheapest
    if quick(rigid) <= HOPELESS * limit and sharp(rigid) <= limit:
        return rigid

    def best(candidates: Iterable[Scene]) -> Scene | None:
        ranked = sorted(((quick(each), each) for each in candidates), key=lambda pair: pair[0])
        promising = (each for error, each in ranked if error <= HOPELESS * limit)
        return next((each for each in promising if sharp(each) <= limit), None)

    def two_poorer(scene: Scene) -> Iterable[Scene]:
        """Return all scenes with two effects or modes less, each once."""
        pairs = [second.scene for first in poorer(scene) for second in poorer(first.scene)]
        return {each.effects.model_dump_json(): each for each in pairs}.values()

    # leave out one effect after another, or two at once, while the error allows it
    scene: Scene | None = richest
    while scene is not None:
        found = scene
        scene = best(each.scene for each in poorer(found)) or best(two_poorer(found))
    return found


def poorer(scene: Scene) -> Iterator[Neighbour]:
    """Return all scenes with one effect or mode less."""
    return (neighbour for neighbour in reductions(scene) if neighbour.effect in CHOOSABLE)


def richer(scene: Scene) -> Iterator[Neighbour]:
    """Return all scenes with one effect or mode more."""
    return (neighbour for neighbour in enrichments(scene) if neighbour.effect in CHOOSABLE)

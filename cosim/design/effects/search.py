"""Searches the cheapest set of effects for a scene and estimates the contribution of each effect.

The search is a backward elimination: it starts with all effects and leaves out those that contribute least, alone or in
pairs, while the estimated errors are within the limit. Loads such as gravity are never left out; their contributions
are estimated too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import get_args

from flexfmu.cosim.design.effects.estimator import Estimator, MetricValues, richest, with_set
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.metrics.small_deflections import MOST_FOUND
from flexfmu.model.enrichment import Neighbour, enrichments, reductions
from flexfmu.model.scene.choice import INTEGRATOR_SHARE, ChoiceSection, EstimatedEffect, MeasureName
from flexfmu.model.scene.effects import CHOOSABLE, LOADS, FamilyName
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

SAFETY = 1.5
"""Safety factor on estimated errors: one Newton iteration and finite time steps leave an error of some percent."""

CONVERGED = 0.1
"""Largest difference of the richest set from the next richer one, in units of the tolerance."""

MOST_MODES = 8
"""Largest number of modes of a family in the richest set."""


def rich_enough(
    scene: Scene,
    motion: Trajectory,
    tolerance: float,
    of: tuple[MeasureName, ...],
    named: Collection[MeasureName] = (),
    journal: WorkJournal = NOWHERE,
    units: MetricValues | None = None,
) -> Scene:
    """Return the scene with a richest set that one more mode of every family changes by at most `CONVERGED` tolerances.

    The set starts as `RICHEST`; modes are added by the size of their contribution. Foreshortening hardly depends on the
    number of modes and is left out meanwhile. Bending is geometrically exact if that makes a difference of `CONVERGED` tolerances.

    Arguments as for `choose_effects`; `named` and `journal` as for `Estimator`; `units` for `scaled`.
    """
    most = richest(scene)
    while True:
        # compare with one more mode of every family
        grown_most = one_more(most, get_args(FamilyName))
        plain, grown = (each.replace({"effects.foreshortening": False}) for each in (most, grown_most))
        estimator = Estimator(scene, motion, of, named, grown, journal)
        estimator = estimator if units is None else estimator.scaled(units)
        # add the mode with the largest contribution until the rest is negligible
        while max(estimator.errors(plain.effects).values()) > CONVERGED * tolerance:
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
    change = Estimator(scene, motion, of, named, exact, journal).errors(most.effects)
    return exact if max(change.values()) > CONVERGED * tolerance else most


def one_more(scene: Scene, families: Sequence[str]) -> Scene:
    """Return the scene with one more mode of these families, up to `MOST_MODES`."""
    return scene.replace({f"effects.{key}": min(getattr(scene.effects, key) + 1, MOST_MODES) for key in families})


def choose_effects(
    scene: Scene,
    motion: Trajectory,
    tolerance: float,
    of: tuple[MeasureName, ...],
    estimator: Estimator | None = None,
    safety: Mapping[MeasureName, float] | None = None,
) -> Scene:
    """Return the scene with the cheapest set of effects whose estimated errors are within their share of the tolerance.

    The other share is the integrator's, `INTEGRATOR_SHARE`. The scene's ``effects.choice`` has the estimates.

    Args:
        scene: robot, loads and motion; its own elastic effects are ignored.
        motion: the planned motion of its motors.
        tolerance: largest relative error of the metrics.
        of: the metrics.
        estimator: of this scene, motion and metrics; a new one when None.
        safety: safety factor on the estimated errors of each metric; `SAFETY` when None.
    """
    estimates = estimator or Estimator(scene, motion, of, most=rich_enough(scene, motion, tolerance, of))
    limit, factor = (1.0 - INTEGRATOR_SHARE) * tolerance, safety or dict.fromkeys(of, SAFETY)

    def error(each: Scene, sharp: bool) -> float:
        return max(factor[name] * value for name, value in estimates.errors(each.effects, sharp=sharp).items())

    chosen = cheapest(
        estimates.richest, with_set(scene, {}), lambda each: error(each, False), lambda each: error(each, True), limit
    )
    # contribution of every effect: change of the metrics without it, or with it where it is not in the set
    worth = tuple(
        EstimatedEffect(
            effect=each.effect,
            change=each.change,
            chosen=is_chosen,
            contribution=tuple(estimates.changes(chosen.effects, each.scene.effects).values()),
        )
        for each, is_chosen in neighbours(estimates, chosen)
    )
    error_of = estimates.errors(chosen.effects)
    choice = ChoiceSection(
        tolerance=tolerance, of=of, error=tuple(factor[name] * error_of[name] for name in of), effects=worth
    )
    return chosen.replace({"effects.choice": choice.model_dump()})


def estimated_errors(estimator: Estimator, scene: Scene) -> Mapping[MeasureName, float]:
    """Return the estimated errors of a scene's set of effects relative to the metrics' scales, `SAFETY` included."""
    return {name: SAFETY * value for name, value in estimator.errors(scene.effects).items()}


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


def effects_of_loads(
    estimator: Estimator,
    chosen: Scene,
    motion: Trajectory,
    measured: Callable[[Scene], MetricValues | None] = lambda scene: None,
) -> Iterator[tuple[Neighbour, EstimatedEffect]]:
    """Yield, for each load of the robot, the scene without it and the change of the metrics.

    Args:
        estimator: of the scene.
        chosen: the scene with a set of effects.
        motion: the planned motion of its motors.
        measured: metrics of a scene's run where it needs one; None where estimates, of motors that follow the motion exactly, suffice
            or it can't run.
    """
    metrics, scales, known = estimator.metrics(chosen.effects), estimator.scales, measured(chosen)
    for without in (each for each in reductions(chosen) if each.effect in LOADS):
        others = Estimator(without.scene, motion, tuple(metrics), most=without.scene).metrics(without.scene.effects)
        observed = None if known is None else measured(without.scene)
        first, second = (metrics, others) if known is None or observed is None else (known, observed)
        shares = tuple(abs(second[name] - first[name]) / scales[name] for name in metrics)
        yield (without, EstimatedEffect(effect=without.effect, change=without.change, chosen=True, contribution=shares))


def absent_effects(scene: Scene) -> tuple[str, ...]:
    """Return the keys of loads that the robot doesn't have."""
    return tuple(key for key in LOADS if key not in scene.loads)

"""The choice itself: the cheapest set of effects for a scene, with what each effect is estimated to be worth.

The search is a backward elimination: it starts with all effects and leaves out what is worth least, alone or in pairs, as long as
the estimated errors allow it. Loads of the robot, gravity for example, are never left out; their worth is estimated too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import get_args

from flexfmu.cosim.choices.effects.estimator import Estimator, richest, with_set
from flexfmu.model.enrichment import Neighbour, enrichments, reductions
from flexfmu.model.scene.choice import INTEGRATOR_SHARE, ChoiceSection, EstimatedEffect, MeasureName
from flexfmu.model.scene.effects import CHOOSABLE, LOADS, FamilyName
from flexfmu.model.scene.schema import Scene
from flexfmu.model.selection.motion_grid import JointMotion

SAFETY = 1.5
"""Factor on estimated errors: one step of Newton's method and finite time steps leave a few percent."""

CONVERGED = 0.1
"""By how many tolerances the richest set may differ from the next richer one."""

MOST_MODES = 8
"""Of a family in the richest set."""


def rich_enough(
    scene: Scene,
    motion: JointMotion,
    tolerance: float,
    of: tuple[MeasureName, ...],
    named: Collection[MeasureName] = (),
) -> Scene:
    """The scene with a richest set that one mode more in every family changes by less than `CONVERGED` of the tolerance.

    It starts as `RICHEST` and grows by the modes that are worth most. Foreshortening hardly depends on the number of modes and is left
    out while they are counted.

    Args and errors: as for `choose_effects`; `named` as for `Estimator`.
    """
    most = richest(scene)
    while True:
        # compare with one mode more of every family
        grown_most = one_more(most, get_args(FamilyName))
        plain, grown = (each.replace({"effects.foreshortening": False}) for each in (most, grown_most))
        estimator = Estimator(scene, motion, of, named, grown)
        # add the mode that is worth most until the rest is negligible
        while max(estimator.errors(plain.effects).values()) > CONVERGED * tolerance:
            steps = [one_more(plain, [family]) for family in get_args(FamilyName)]
            plain = min(
                (each for each in steps if estimator.covers(each.effects) and each != plain),
                key=lambda each: max(estimator.errors(each.effects).values()),
            )
        # done where nothing was added, or nothing can be
        found = plain.replace({"effects.foreshortening": True})
        if found == most or grown_most == most:
            return most
        most = found


def one_more(scene: Scene, families: Sequence[str]) -> Scene:
    """The scene with one mode more of some families, as far as `MOST_MODES`."""
    return scene.replace({f"effects.{key}": min(getattr(scene.effects, key) + 1, MOST_MODES) for key in families})


def choose_effects(
    scene: Scene,
    motion: JointMotion,
    tolerance: float,
    of: tuple[MeasureName, ...],
    estimator: Estimator | None = None,
    safety: Mapping[MeasureName, float] | None = None,
) -> Scene:
    """The scene with the cheapest set of effects whose estimated errors are within half the tolerance.

    What was estimated stands in the scene's ``effects.choice``. The other half of the tolerance is the integrator's.

    Args:
        scene: robot, loads and motion; its own choice of elastic effects doesn't matter.
        motion: the planned motion of its motors.
        tolerance: largest relative error of the metrics.
        of: the metrics.
        estimator: for this scene, motion and metrics, where there is one.
        safety: by what the estimates of each metric are multiplied; `SAFETY` when None.
    """
    estimates = estimator or Estimator(scene, motion, of, most=rich_enough(scene, motion, tolerance, of))
    limit, factor = (1.0 - INTEGRATOR_SHARE) * tolerance, safety or dict.fromkeys(of, SAFETY)

    def error(each: Scene, sharp: bool) -> float:
        return max(factor[name] * value for name, value in estimates.errors(each.effects, sharp=sharp).items())

    chosen = cheapest(
        estimates.richest, with_set(scene, {}), lambda each: error(each, False), lambda each: error(each, True), limit
    )
    # every effect, in the set or not, with what the metrics change without it, or with it
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
    """Errors of a scene's set of effects because of what it leaves out, `SAFETY` included, relative to the metrics' scales."""
    return {name: SAFETY * value for name, value in estimator.errors(scene.effects).items()}


def neighbours(estimator: Estimator, chosen: Scene) -> list[tuple[Neighbour, bool]]:
    """Scenes with one effect less, True, and with one more, False, as far as the richest set goes."""
    found = [(each, True) for each in poorer(chosen)] + [(each, False) for each in richer(chosen)]
    return [pair for pair in found if estimator.covers(pair[0].scene.effects)]


Error = Callable[[Scene], float]
"""Scene → error of its set of effects, the largest over all metrics."""

HOPELESS = 3.0
"""Error of a quick estimate, in units of the limit, from which no sharp estimate is made."""


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
    # nothing is cheaper than rigid links
    if quick(rigid) <= HOPELESS * limit and sharp(rigid) <= limit:
        return rigid

    def best(candidates: Iterable[Scene]) -> Scene | None:
        ranked = sorted(((quick(each), each) for each in candidates), key=lambda pair: pair[0])
        promising = (each for error, each in ranked if error <= HOPELESS * limit)
        return next((each for each in promising if sharp(each) <= limit), None)

    def two_poorer(scene: Scene) -> Iterable[Scene]:
        """All scenes with two effects or modes less, each once."""
        pairs = [second.scene for first in poorer(scene) for second in poorer(first.scene)]
        return {each.effects.model_dump_json(): each for each in pairs}.values()

    # leave out one effect after another, or two at once, until nothing more can go
    scene: Scene | None = richest
    while scene is not None:
        found = scene
        scene = best(each.scene for each in poorer(found)) or best(two_poorer(found))
    return found


def poorer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode less."""
    return (neighbour for neighbour in reductions(scene) if neighbour.effect in CHOOSABLE)


def richer(scene: Scene) -> Iterator[Neighbour]:
    """All scenes with one effect or mode more."""
    return (neighbour for neighbour in enrichments(scene) if neighbour.effect in CHOOSABLE)


def effects_of_loads(
    estimator: Estimator, chosen: Scene, motion: JointMotion
) -> Iterator[tuple[Neighbour, EstimatedEffect]]:
    """Each load of the robot, as the scene without it and what that would change in the metrics.

    Args:
        estimator: of the scene.
        chosen: the scene with a set of effects.
        motion: of its motors.
    """
    metrics, scales = estimator.metrics(chosen.effects), estimator.scales
    for without in (each for each in reductions(chosen) if each.effect in LOADS):
        others = Estimator(without.scene, motion, tuple(metrics)).metrics(without.scene.effects)
        shares = tuple(abs(others[name] - value) / scales[name] for name, value in metrics.items())
        yield (
            without,
            EstimatedEffect(effect=without.effect, change=without.change, chosen=True, contribution=shares),
        )


def absent_effects(scene: Scene) -> tuple[str, ...]:
    """Keys of loads that the robot doesn't have."""
    return tuple(key for key in LOADS if key not in scene.loads)

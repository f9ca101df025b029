"""The choice itself: the cheapest set of effects for a scene, with what each effect is estimated to be worth."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import get_args

from flexfmu.model.choice_section import INTEGRATOR_SHARE, Choice, EstimatedEffect, MeasureName
from flexfmu.model.enrichment import Neighbour
from flexfmu.model.scene import FamilyName, Scene
from flexfmu.model.selection.estimator import Estimator
from flexfmu.model.selection.motion_grid import JointMotion
from flexfmu.model.selection.richest import richest, with_set
from flexfmu.model.selection.search import cheapest, poorer, richer

SAFETY = 1.5
"""By what estimated errors are multiplied: one step of Newton's method and finite time steps leave a few percent."""


CONVERGED = 0.1
"""By how many tolerances the richest set may differ from the next richer one."""

MOST_MODES = 8
"""Of a family in the richest set."""


def rich_enough(
    scene: Scene,
    motion: JointMotion,
    tolerance: float,
    of: tuple[MeasureName, ...],
    asked: Collection[MeasureName] = (),
) -> Scene:
    """The scene with a richest set that one mode more in every family changes by less than `CONVERGED` of the tolerance.

    It starts as `RICHEST` and grows by the modes that are worth most. Foreshortening hardly depends on the number of modes and is left
    out while they are counted.

    Args and errors: as for `choose_effects`; `asked` as for `Estimator`.
    """
    most = richest(scene)
    while True:
        richer = one_more(most, get_args(FamilyName))
        plain, grown = (each.replace({"effects.foreshortening": False}) for each in (most, richer))
        estimator = Estimator(scene, motion, of, asked, grown)
        while max(estimator.errors(plain.effects).values()) > CONVERGED * tolerance:
            steps = [one_more(plain, [family]) for family in get_args(FamilyName)]
            plain = min(
                (each for each in steps if estimator.covers(each.effects) and each != plain),
                key=lambda each: max(estimator.errors(each.effects).values()),
            )
        found = plain.replace({"effects.foreshortening": True})
        if found == most or richer == most:
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
    error_of = estimates.errors(chosen.effects)
    errors = tuple(factor[name] * error_of[name] for name in of)
    choice = Choice(tolerance=tolerance, of=of, error=errors, effects=tuple(_estimated(estimates, chosen)))
    return chosen.replace({"effects.choice": choice.model_dump()})


def estimated_errors(estimator: Estimator, scene: Scene) -> Mapping[MeasureName, float]:
    """Errors of a scene's set of effects because of what it leaves out, `SAFETY` included, relative to the metrics' scales."""
    return {name: SAFETY * value for name, value in estimator.errors(scene.effects).items()}


def neighbours(estimator: Estimator, chosen: Scene) -> list[tuple[Neighbour, bool]]:
    """Scenes with one effect less, True, and with one more, False, as far as the richest set goes."""
    found = [(each, True) for each in poorer(chosen)] + [(each, False) for each in richer(chosen)]
    return [pair for pair in found if estimator.covers(pair[0].scene.effects)]


def _estimated(estimator: Estimator, chosen: Scene) -> list[EstimatedEffect]:
    """Every effect, in the set or not, with what the metrics change without it, or with it."""
    return [
        EstimatedEffect(
            effect=each.effect,
            change=each.change,
            chosen=is_chosen,
            contribution=tuple(estimator.changes(chosen.effects, each.scene.effects).values()),
        )
        for each, is_chosen in neighbours(estimator, chosen)
    ]

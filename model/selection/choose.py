"""The choice itself: the cheapest set of effects for a scene, with what each effect is estimated to be worth."""

from __future__ import annotations

from collections.abc import Mapping

from flexfmu.model.choice_section import INTEGRATOR_SHARE, Choice, EstimatedEffect, MeasureName
from flexfmu.model.enrichment import Neighbour
from flexfmu.model.scene import Scene
from flexfmu.model.selection.estimator import Estimator
from flexfmu.model.selection.motion_grid import JointMotion
from flexfmu.model.selection.richest import richest, with_set
from flexfmu.model.selection.search import cheapest, poorer, richer

SAFETY = 1.5
"""By what estimated errors are multiplied: one step of Newton's method and finite time steps leave a few percent."""


def choose_effects(
    scene: Scene, motion: JointMotion, tolerance: float, of: tuple[MeasureName, ...], estimator: Estimator | None = None
) -> Scene:
    """The scene with the cheapest set of effects whose estimated errors are within half the tolerance.

    What was estimated stands in the scene's ``effects.choice``. The other half of the tolerance is the integrator's.

    Args:
        scene: robot, loads and motion; its own choice of elastic effects doesn't matter.
        motion: the planned motion of its motors.
        tolerance: largest relative error of the metrics.
        of: the metrics.
        estimator: for this scene, motion and metrics, where there is one.
    """
    estimates = estimator or Estimator(scene, motion, of)
    limit = (1.0 - INTEGRATOR_SHARE) * tolerance
    chosen = cheapest(
        richest(scene),
        with_set(scene, {}),
        lambda each: SAFETY * max(estimates.errors(each.effects, sharp=False).values()),
        lambda each: max(estimated_errors(estimates, each).values()),
        limit,
    )
    error = tuple(estimated_errors(estimates, chosen).values())
    choice = Choice(tolerance=tolerance, of=of, error=error, effects=tuple(_estimated(estimates, chosen)))
    return chosen.replace({"effects.choice": choice.model_dump()})


def estimated_errors(estimator: Estimator, scene: Scene) -> Mapping[MeasureName, float]:
    """Errors of a scene's set of effects because of what it leaves out, safety included, relative to the metrics' scales."""
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

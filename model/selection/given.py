"""What the robot itself gives a scene, gravity for example, and is never left out: what each of these effects is worth."""

from __future__ import annotations

from collections.abc import Iterator

from flexfmu.model.choice_section import EstimatedEffect
from flexfmu.model.enrichment import LOADS, Neighbour, reductions
from flexfmu.model.scene import Scene
from flexfmu.model.selection.estimator import Estimator
from flexfmu.model.selection.motion_grid import JointMotion


def given_effects(
    estimator: Estimator, chosen: Scene, motion: JointMotion
) -> Iterator[tuple[Neighbour, EstimatedEffect]]:
    """Each effect that the robot gives, as the scene without it and what that would change in the metrics.

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
    """What a robot may give that this one doesn't: keys of the scene."""
    given = {each.effect for each in reductions(scene)}
    return tuple(key for key in LOADS if key not in given)

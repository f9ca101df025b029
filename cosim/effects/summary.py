"""An automatic choice of effects as plain data."""

from __future__ import annotations

from typing import Any

from flexfmu.model.scene import CHOOSABLE, Scene


def chosen_set(scene: Scene) -> dict[str, Any]:
    """The keys of `effects` that are a matter of choice, with the scene's values."""
    return scene.effects.model_dump(mode="json", include=set(CHOOSABLE))


def choice_summary(scene: Scene) -> dict[str, Any]:
    """What was chosen, for what, and what each effect is estimated to be worth; nothing where the scene chose itself."""
    choice = scene.effects.choice
    if choice is None:
        return {}
    return {
        "tolerance": choice.tolerance,
        "of": list(choice.of),
        "chosen": chosen_set(scene),
        "estimated_error": dict(zip(choice.of, choice.error, strict=True)),
        "integrator_tolerance": scene.cosimulation.tolerance,
        "effects": [
            {
                "effect": each.effect,
                "change": each.change,
                "chosen": each.chosen,
                "contribution": dict(zip(choice.of, each.contribution, strict=True)),
            }
            for each in choice.effects
        ],
    }

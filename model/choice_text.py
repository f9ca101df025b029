"""Sentences about an automatic choice of effects, for the command line and the documentation of FMUs."""

from __future__ import annotations

from collections.abc import Mapping

from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import EffectNote

_FAMILIES: Mapping[str, str] = {
    "proximal_bending": "proximal bending",
    "proximal_axial": "proximal axial",
    "distal_bending": "distal bending",
    "distal_axial": "distal axial",
}


def percent(value: float | None) -> str:
    """A relative error in percent with two significant digits; a dash for an unknown one."""
    if value is None:
        return "–"
    if value >= 0.1:
        return f"{100.0 * value:.0f} %"
    return "0" if value == 0.0 else f"{100.0 * value:.2g} %" if value >= 1e-6 else "< 0.0001 %"


def set_text(scene: Scene) -> str:
    """The elastic effects of a scene, separated by commas."""
    effects = scene.effects
    # number of modes of each family, then beam theory and foreshortening
    found = [
        f"{word} {getattr(effects, key)}{' static' if key in effects.quasi_static else ''}"
        for key, word in _FAMILIES.items()
        if getattr(effects, key)
    ]
    found += ["shear and rotary inertia"] if effects.beam == "timoshenko" else []
    if effects.foreshortening:
        found.append("geometrically exact bending" if effects.foreshortening == "exact" else "foreshortening")
    return ", ".join(found) or "rigid links"


def choice_sentence(scene: Scene) -> str:
    """The chosen effects in one line; empty where the scene names its effects itself."""
    choice = scene.effects.choice
    if choice is None:
        return ""
    known = choice.error if choice.verified is None else choice.verified
    errors = ", ".join(f"{name} {percent(value)}" for name, value in zip(choice.of, known, strict=True))
    how = "estimated errors" if choice.verified is None else "errors beside the richest set"
    alone = ", of the motion alone" if choice.verified_in == "motion" else ""
    pairs = zip(choice.of, choice.verified or (), strict=False)
    beyond = [name for name, value in pairs if value is not None and value > choice.tolerance]
    missed = (
        f"; NOT within {percent(choice.tolerance)}: {', '.join(beyond)}, with a tolerance of the FMU of "
        f"{scene.cosimulation.tolerance:g}; leave out `cosimulation.tolerance` and `cosimulation.integrator_step`, or ask for less"
        if beyond
        else ""
    )
    return f"effects chosen for {percent(choice.tolerance)}: {set_text(scene)} ({how}{alone}: {errors}{missed})"


def choice_notes(scene: Scene) -> tuple[EffectNote, ...]:
    """The documentation's note on an automatic choice; empty where the scene names its effects itself."""
    choice = scene.effects.choice
    if choice is None:
        return ()
    # effects left out, each with the largest of its estimated contributions
    left_out = ", ".join(
        f"{each.effect} ({each.change}) {percent(max((x for x in each.contribution if x is not None), default=None))}"
        for each in choice.effects
        if not each.chosen
    )
    sentence = choice_sentence(scene)
    return (
        EffectNote("choice of effects", f"{sentence[0].upper()}{sentence[1:]}. Left out: {left_out or 'nothing'}."),
    )

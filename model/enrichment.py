"""The neighbours of a scene: one effect richer, or one effect poorer; for choosing effects by what each is worth.

What the links may do is a choice (elastic families and the number of their modes, beam theory, foreshortening), so both
directions have it. Loads and drives are given by the robot (payload, gravity, damping, friction, motors,
transmissions): they can be left out, but a scene without them doesn't say how large they would be.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from flexfmu.model.robot import FAMILIES
from flexfmu.model.scene.effects import LOADS, MAXIMUM_MODES, Effects
from flexfmu.model.scene.schema import Scene

EffectChanges = dict[str, Any]


@dataclass(frozen=True)
class Neighbour:
    """A scene that differs in one effect.

    Attributes:
        effect: the effect's key in the scene file, below `effects` unless it has a dot in it, like ``payload.inertia``.
        change: what is different, for people: ``2 modes instead of 1``.
        scene: the scene with this difference.
    """

    effect: str
    change: str
    scene: Scene


def enrichments(scene: Scene) -> tuple[Neighbour, ...]:
    """All scenes that have one effect or one mode more."""
    effects = scene.effects
    steps: list[tuple[str, str, EffectChanges]] = []
    # elastic families; the tip of a distal link that bends doesn't move, so that no static shape helps there
    for key, modes, static in _families(effects):
        if static:
            steps.append((key, "vibrating instead of deflecting statically", _static(effects, key, False)))
        if not modes and key != "distal_bending":
            steps.append((key, "1 mode, deflecting statically", {f"effects.{key}": 1} | _static(effects, key, True)))
        if modes < MAXIMUM_MODES:
            steps.append((key, _instead(modes + 1, modes), {f"effects.{key}": modes + 1}))
    # beam theory
    if effects.beam == "euler-bernoulli":
        steps.append(("beam", "with shear and rotary inertia", {"effects.beam": "timoshenko"}))
    if not effects.foreshortening and (effects.proximal_bending or effects.distal_bending):
        steps.append(("foreshortening", "with foreshortening", {"effects.foreshortening": True}))
    return tuple(Neighbour(effect, change, scene.replace(values)) for effect, change, values in steps)


def reductions(scene: Scene) -> tuple[Neighbour, ...]:
    """All scenes that have one effect or one mode less."""
    effects = scene.effects
    steps: list[tuple[str, str, EffectChanges]] = []
    # elastic families
    for key, modes, static in _families(effects):
        if modes and not static and key != "distal_bending":
            steps.append((key, "deflecting statically instead of vibrating", _static(effects, key, True)))
        if modes > 1:
            steps.append((key, _instead(modes - 1, modes), {f"effects.{key}": modes - 1}))
        if modes == 1:
            steps.append((key, "rigid", {f"effects.{key}": 0} | _static(effects, key, False)))
    # beam theory
    if effects.beam == "timoshenko":
        steps.append(("beam", "without shear and rotary inertia", {"effects.beam": "euler-bernoulli"}))
    if effects.foreshortening and (effects.proximal_bending or effects.distal_bending):
        steps.append(("foreshortening", "without foreshortening", {"effects.foreshortening": False}))
    # loads of the robot; the payload's mass is what the robot is there for, and stays
    for key in scene.loads:
        full = key if "." in key else f"effects.{key}"
        steps.append((key, LOADS[key].change, {full: LOADS[key].absent}))
    return tuple(Neighbour(effect, change, scene.replace(values)) for effect, change, values in steps)


def _families(effects: Effects) -> Iterator[tuple[str, int, bool]]:
    """Key, number of modes and whether they deflect statically, of each elastic family."""
    for group, direction in FAMILIES:
        key = f"{group}_{direction}"
        yield key, getattr(effects, key), key in effects.quasi_static


def _static(effects: Effects, key: str, wanted: bool) -> EffectChanges:
    """The list of quasi-static families with or without one of them."""
    others = [family for family in effects.quasi_static if family != key]
    return {"effects.quasi_static": [*others, key] if wanted else others}


def _instead(new: int, old: int) -> str:
    return f"{new} mode{'' if new == 1 else 's'} instead of {old}"

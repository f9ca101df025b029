"""Neighbours of a scene, which have one effect more or one less; the choice of effects compares them.

The elastic effects of the links are a choice (families and their numbers of modes, beam theory, foreshortening): they
can be added and left out. Loads and drives belong to the robot (payload, gravity, damping, friction, motors,
transmissions): they can only be left out, as a scene without them doesn't give their size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from flexfmu.model.beams import FAMILIES
from flexfmu.model.scene.effects import LOADS, MAXIMUM_MODES, Effects
from flexfmu.model.scene.schema import Scene

EffectChanges = dict[str, Any]

FOLLOWING: Mapping[str, Any] = {
    **dict.fromkeys(("controller", "shaper", "imperfection", "filter", "disturbance"), ()),
    "cosimulation.drive": "motion",
}
"""Changes of a scene that leave the robot alone, its motors following the planned motion exactly."""


@dataclass(frozen=True)
class Neighbour:
    """A scene that differs in one effect.

    Attributes:
        effect: key of the effect in the scene file, below `effects` unless it contains a dot, like ``payload.inertia``.
        change: the difference in words: ``2 modes instead of 1``.
        scene: the scene with this difference.
    """

    effect: str
    change: str
    scene: Scene


def enrichments(scene: Scene) -> tuple[Neighbour, ...]:
    """All scenes that have one effect or one mode more."""
    effects = scene.effects
    steps: list[tuple[str, str, EffectChanges]] = []
    # elastic families; bending doesn't displace the tip of a distal link, so no static shape is offered there
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
    steps += _shortenings(effects, 1)
    return tuple(Neighbour(effect, change, scene.replace(values)) for effect, change, values in steps)


def reductions(scene: Scene) -> tuple[Neighbour, ...]:
    """All scenes that have one effect or one mode less.

    A motor without inertia in front of an elastic transmission has no equation of motion; it follows the planned motion instead.
    """
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
    steps += _shortenings(effects, -1)
    # loads of the robot; the mass of the payload stays
    for key in scene.loads:
        full = key if "." in key else f"effects.{key}"
        massless = key == "motor_inertia" and effects.transmission is not None
        steps.append((key, LOADS[key].change, {**(FOLLOWING if massless else {}), full: LOADS[key].absent}))
    return tuple(Neighbour(effect, change, scene.replace(values)) for effect, change, values in steps)


def _families(effects: Effects) -> Iterator[tuple[str, int, bool]]:
    """Key and number of modes of each elastic family, and whether it deflects statically."""
    for group, direction in FAMILIES:
        key = f"{group}_{direction}"
        yield key, getattr(effects, key), key in effects.quasi_static


THEORIES = (False, True, "exact")
"""Values of `foreshortening`, from nothing to everything."""

_SHORTENINGS = {
    1: ("", "with foreshortening", "with geometrically exact bending"),
    -1: ("without foreshortening", "with foreshortening instead of exact bending", ""),
}
"""The change to each of `THEORIES` in words, from a poorer and from a richer one."""


def _shortenings(effects: Effects, step: Literal[1, -1]) -> Iterator[tuple[str, str, EffectChanges]]:
    """The next richer or poorer theory of foreshortening, where there is one and links bend."""
    following = THEORIES.index(effects.foreshortening) + step
    if (effects.proximal_bending or effects.distal_bending) and 0 <= following < len(THEORIES):
        yield "foreshortening", _SHORTENINGS[step][following], {"effects.foreshortening": THEORIES[following]}


def _static(effects: Effects, key: str, wanted: bool) -> EffectChanges:
    """The change that adds a family to `quasi_static` or removes it."""
    others = [family for family in effects.quasi_static if family != key]
    return {"effects.quasi_static": [*others, key] if wanted else others}


def _instead(new: int, old: int) -> str:
    return f"{new} mode{'' if new == 1 else 's'} instead of {old}"

"""The neighbours of a scene: one effect richer, or one effect poorer; for choosing effects by what each is worth.

What the links may do is a choice (elastic families and the number of their modes, beam theory, foreshortening), so both
directions have it. Loads and drives are given by the robot (payload, gravity, damping, friction, motors, transmissions): they
can be left out, but a scene without them doesn't say how large they would be.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from flexfmu.model.robot import FAMILIES
from flexfmu.model.scene.effects import LOADS, MAXIMUM_MODES, Effects
from flexfmu.model.scene.schema import Scene

Changes = dict[str, Any]


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
    return tuple(_neighbours(scene, (*_more_elastic(scene.effects), *_finer_beams(scene.effects))))


def reductions(scene: Scene) -> tuple[Neighbour, ...]:
    """All scenes that have one effect or one mode less."""
    steps = (*_less_elastic(scene.effects), *_coarser_beams(scene.effects), *_without_loads(scene))
    return tuple(_neighbours(scene, steps))


Step = tuple[str, str, Changes]
"""Effect, change, and values of the scene's keys."""


def _neighbours(scene: Scene, steps: Iterable[Step]) -> Iterator[Neighbour]:
    for effect, change, values in steps:
        yield Neighbour(effect, change, scene.replace(values))


def _families(effects: Effects) -> Iterator[tuple[str, int, bool]]:
    """Key, number of modes and whether they deflect statically, of each elastic family."""
    for group, direction in FAMILIES:
        key = f"{group}_{direction}"
        yield key, getattr(effects, key), key in effects.quasi_static


def _more_elastic(effects: Effects) -> Iterator[Step]:
    for key, modes, static in _families(effects):
        if static:
            yield key, "vibrating instead of deflecting statically", _static(effects, key, False)
        if not modes and key != "distal_bending":  # whose tip doesn't move
            yield key, "1 mode, deflecting statically", {f"effects.{key}": 1} | _static(effects, key, True)
        if modes < MAXIMUM_MODES:
            yield key, _instead(modes + 1, modes), {f"effects.{key}": modes + 1}


def _less_elastic(effects: Effects) -> Iterator[Step]:
    for key, modes, static in _families(effects):
        if modes and not static and key != "distal_bending":
            yield key, "deflecting statically instead of vibrating", _static(effects, key, True)
        if modes > 1:
            yield key, _instead(modes - 1, modes), {f"effects.{key}": modes - 1}
        if modes == 1:
            yield key, "rigid", {f"effects.{key}": 0} | _static(effects, key, False)


def _static(effects: Effects, key: str, wanted: bool) -> Changes:
    """The list of quasi-static families with or without one of them."""
    others = [family for family in effects.quasi_static if family != key]
    return {"effects.quasi_static": [*others, key] if wanted else others}


def _instead(new: int, old: int) -> str:
    return f"{new} mode{'' if new == 1 else 's'} instead of {old}"


def _finer_beams(effects: Effects) -> Iterator[Step]:
    if effects.beam == "euler-bernoulli":
        yield "beam", "with shear and rotary inertia", {"effects.beam": "timoshenko"}
    if not effects.foreshortening and _bends(effects):
        yield "foreshortening", "with foreshortening", {"effects.foreshortening": True}


def _coarser_beams(effects: Effects) -> Iterator[Step]:
    if effects.beam == "timoshenko":
        yield "beam", "without shear and rotary inertia", {"effects.beam": "euler-bernoulli"}
    if effects.foreshortening and _bends(effects):
        yield "foreshortening", "without foreshortening", {"effects.foreshortening": False}


def _bends(effects: Effects) -> bool:
    return bool(effects.proximal_bending or effects.distal_bending)


def _without_loads(scene: Scene) -> Iterator[Step]:
    """Loads of the robot, left out; the payload's mass is what the robot is there for, and stays."""
    for key in scene.loads:
        full = key if "." in key else f"effects.{key}"
        yield key, LOADS[key].change, {full: LOADS[key].absent}

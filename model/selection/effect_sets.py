"""The richest set of effects that a choice is compared with, and what of a scene isn't a matter of choice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flexfmu.model.scene.effects import CHOOSABLE, Effects
from flexfmu.model.scene.schema import Scene

RICHEST: Mapping[str, Any] = {
    "proximal_bending": 3,
    "proximal_axial": 1,
    "distal_bending": 2,
    "distal_axial": 1,
    "beam": "timoshenko",
    "foreshortening": True,
    "quasi_static": [],
}
"""Values of the keys below `effects`. One shape more of each family changes no metric of the paper's scenes by 1e-3, see
``tests/model/selection/test_selection.py``."""

_REQUEST: Mapping[str, Any] = {"select": None, "tolerance": None, "of": None, "choice": None}


def with_set(scene: Scene, chosen: Mapping[str, Any]) -> Scene:
    """The scene with values of the keys that are a matter of choice, and without the wish to have them chosen."""
    values = {key: type(scene.effects).model_fields[key].default for key in CHOOSABLE} | dict(chosen)
    changes = {**values, "basis": "craig-bampton", **_REQUEST}
    return scene.replace({f"effects.{key}": value for key, value in changes.items()})


def richest(scene: Scene) -> Scene:
    """The scene with all elastic effects."""
    return with_set(scene, RICHEST)


def with_beams(scene: Scene, effects: Effects) -> Scene:
    """A scene with the beam theory of a set of effects."""
    return scene.replace({"effects.beam": effects.beam, "effects.foreshortening": effects.foreshortening})

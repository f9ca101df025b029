"""The plants that a scene can drive."""

from __future__ import annotations

from dataclasses import replace

from flexfmu.model.motion_driven import motion_driven_plant
from flexfmu.model.scene import Scene
from flexfmu.model.selection.words import choice_notes
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.model.torque_driven import torque_driven_plant


def build_model(scene: Scene) -> SymbolicModel:
    """The plant that a scene drives as equations and variables."""
    model = torque_driven_plant(scene) if scene.cosimulation.drive == "torque" else motion_driven_plant(scene)
    return replace(model, effects=(*model.effects, *choice_notes(scene)))

"""The plants that a scene can drive."""

from __future__ import annotations

from flexfmu.model.motion_driven import motion_driven_plant
from flexfmu.model.scene import Scene
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.model.torque_driven import torque_driven_plant


def build_model(scene: Scene) -> SymbolicModel:
    """The plant that a scene drives as equations and variables."""
    return torque_driven_plant(scene) if scene.cosimulation.drive == "torque" else motion_driven_plant(scene)

"""The plants that a scene can drive."""

from __future__ import annotations

from flexfmu.model.errors import SceneError
from flexfmu.model.motion_driven import motion_driven_plant
from flexfmu.model.scene import Scene
from flexfmu.model.symbolic import SymbolicModel


def build_model(scene: Scene) -> SymbolicModel:
    """The plant of a scene as equations and variables.

    Raises:
        SceneError: the scene asks for a plant that doesn't exist.
    """
    if scene.cosimulation.drive == "torque":
        raise SceneError(f"`cosimulation.drive` = 'torque' is not available yet: use 'motion' (scene {scene.name})")
    return motion_driven_plant(scene)
